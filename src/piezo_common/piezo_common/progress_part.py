# SPDX-License-Identifier: BSD-3-Clause
"""The progress of a part of some work, told as progress of the whole."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Takes what is being done, and which fraction of the work is done."""


def part_of(progress: Progress | None, begin: float, end: float) -> Progress:
    """Return what a part of the work is to call.

    Parameters
    ----------
    progress : callable or None
        Of the whole; nobody is told where it is None.
    begin, end : float
        Fractions of the whole at which the part begins and ends.
    """
    if progress is None:
        return lambda what, fraction: None
    return lambda what, fraction: progress(what, begin + (end - begin) * fraction)
