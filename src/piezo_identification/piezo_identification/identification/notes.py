# SPDX-License-Identifier: BSD-3-Clause
"""Notes of an identification for its user, some of them of a type that programs recognise."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Implausible(str):
    """A sentence on an implausible result."""


class Detail(str):
    """A sentence or table on how a result was found, which programs may leave out.

    The function `plot`, if there is one, draws the table.
    """

    plot: "Callable[[], Figure] | None"

    def __new__(cls, text: str, plot: "Callable[[], Figure] | None" = None) -> "Detail":
        """Return the text with the function that draws it."""
        detail = super().__new__(cls, text)
        detail.plot = plot
        return detail


@contextmanager
def notes_printed(verbose: bool) -> Iterator[list[str]]:
    """Provide a list for notes, which are printed at the end, with details only if verbose."""
    notes: list[str] = []
    try:
        yield notes
    finally:
        for note in notes:
            if verbose or not isinstance(note, Detail):
                print(note)
