# SPDX-License-Identifier: BSD-3-Clause
"""Time that work may take: once it is over, the work ends with the best that it has found."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from piezo_common.cancellation import also_checking, check_cancelled


class TimeIsUp(Exception):
    """The time of a part of the work is over."""


class Budget:
    """Time that work may take, and what it has not tried when that was over.

    Parameters
    ----------
    seconds : float, optional
        By default there is no end.
    clock : callable
        Returns seconds.
    taken_s : float
        Of this time, what was taken before.
    to_write_s : float
        Of this time, what no search may take, as results have to be drawn and written.

    Attributes
    ----------
    not_tried : list of str
    is_interrupted : bool
        Ctrl-C has ended the work.

    Raises
    ------
    ValueError
        If the time is not positive.
    """

    def __init__(self, seconds: float | None = None,
                 clock: Callable[[], float] = time.monotonic, taken_s: float = 0.0,
                 to_write_s: float = 0.0) -> None:
        if seconds is not None and not seconds > 0.0:
            raise ValueError(f"the budget is {seconds:g} s: give a positive number of seconds")
        self._seconds = float("inf") if seconds is None else seconds
        self._clock, self._begun_s, self._to_write_s = clock, clock() - taken_s, to_write_s
        self.not_tried: list[str] = []
        self.is_interrupted = False

    @property
    def taken_s(self) -> float:
        """Return the time since the work began."""
        return self._clock() - self._begun_s

    @property
    def left_s(self) -> float:
        """Return the time that is left; infinite without an end."""
        return 0.0 if self.is_interrupted else max(self._seconds - self.taken_s, 0.0)

    def is_spent(self, share: float = 1.0) -> bool:
        """Tell whether a share of the time for searches is over."""
        return self.is_interrupted or self.taken_s >= share * (self._seconds - self._to_write_s)

    def sentence(self, done: str = "tried") -> str:
        """Return what was not done, and why; empty if all was."""
        if not self.not_tried:
            return ""
        why = "interrupted" if self.is_interrupted else f"the time of {self._seconds:g} s is over"
        return f"{why}; not {done}: {'; '.join(dict.fromkeys(self.not_tried))}"


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextmanager
def spending(budget: Budget) -> Iterator[None]:
    """Let the blocks of `while_time_lasts` in this context end by a budget."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


SEARCH = 0.9
"""Share of the time that searches may take: results have to be judged and written, too."""


@dataclass
class Part:
    """A part of the work.

    Attributes
    ----------
    was_cut : bool
        It has ended before it was done.
    """

    was_cut: bool = False


@contextmanager
def while_time_lasts(what: str, share: float = SEARCH) -> Iterator[Part]:
    """End a block early and quietly, once a share of the time of the budget is over.

    It ends where it calls `check_cancelled`, and where Ctrl-C finds it; what it has found until
    then counts. Without a budget around it, it ends by Ctrl-C alone.

    Parameters
    ----------
    what : str
        Noted as not tried if the block ends early.
    share : float
    """
    budget, part = _budget.get() or Budget(), Part()

    def check() -> None:
        if budget.is_spent(share):
            raise TimeIsUp

    try:
        with also_checking(check):
            yield part
    except (TimeIsUp, KeyboardInterrupt) as end:
        budget.is_interrupted |= isinstance(end, KeyboardInterrupt)
        budget.not_tried.append(what)
        part.was_cut = True


def has_time_for(what: str, share: float = SEARCH) -> bool:
    """Tell whether there is time for a part of the work, which is noted as not tried otherwise."""
    with while_time_lasts(what, share) as part:
        check_cancelled()
    return not part.was_cut


def is_time_up() -> bool:
    """Tell whether the block of `while_time_lasts` around has to end."""
    try:
        check_cancelled()
    except TimeIsUp:
        return True
    return False
