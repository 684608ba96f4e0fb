# SPDX-License-Identifier: BSD-3-Clause
"""The progress of a part of some work, converted to that of the whole."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with the present step and the fraction of the work that is done (0 to 1)."""


def part_of(progress: Progress | None, begin: float, end: float) -> Progress:
    """Return the progress function for a part of the work between two fractions of the whole.

    Without a progress function of the whole, nothing is reported.
    """
    if progress is None:
        return lambda what, fraction: None
    return lambda what, fraction: progress(what, begin + (end - begin) * fraction)
