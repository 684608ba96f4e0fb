# SPDX-License-Identifier: BSD-3-Clause
"""A limit of the time for some work, which then ends with the best result so far."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from piezo_common.cancellation import also_checking, check_cancelled


class TimeIsUp(Exception):
    """The time for a part of the work is over."""


class Budget:
    """The time for some work, and what was not tried when it was over.

    The time in s is unlimited by default; ValueError is raised if it is not positive. The part
    `taken_s` was used before, and the part `to_write_s` is reserved for drawing and writing
    results, both in s. The clock returns the time in s.

    `not_tried` lists the parts of the work that were not tried, and `is_interrupted` is True if
    Ctrl-C has ended the work.
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
        """Return the time since the work began in s."""
        return self._clock() - self._begun_s

    @property
    def left_s(self) -> float:
        """Return the remaining time in s; infinite without a limit."""
        return 0.0 if self.is_interrupted else max(self._seconds - self.taken_s, 0.0)

    def is_spent(self, share: float = 1.0) -> bool:
        """Return True if a share of the time for searches is over."""
        return self.is_interrupted or self.taken_s >= share * (self._seconds - self._to_write_s)

    def sentence(self, done: str = "tried") -> str:
        """Return what was not done and why; empty if everything was done."""
        if not self.not_tried:
            return ""
        why = "interrupted" if self.is_interrupted else (
            f"the time of {self._seconds:g} s does not suffice")
        return f"{why}; not {done}: {'; '.join(dict.fromkeys(self.not_tried))}"


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextmanager
def spending(budget: Budget) -> Iterator[None]:
    """Make the blocks of `while_time_lasts` in this context end when the budget is spent."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


SEARCH = 0.9
"""Share of the time for searches; the rest is for assessing and writing the results."""


@dataclass
class Part:
    """A part of the work."""

    was_cut: bool = False
    """True if it ended early."""


@contextmanager
def while_time_lasts(what: str, share: float = SEARCH) -> Iterator[Part]:
    """End a block early without an exception, once a share (0 to 1) of the budget's time is over.

    It ends at a call of `check_cancelled`, or at Ctrl-C; its results so far are used. Without a
    budget it ends only at Ctrl-C. The name of the part is noted as not tried if the block ends
    early.
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
    """Return True if there is time for a part of the work, else note it as not tried."""
    with while_time_lasts(what, share) as part:
        check_cancelled()
    return not part.was_cut


def is_time_up() -> bool:
    """Return True if the surrounding block of `while_time_lasts` must end."""
    try:
        check_cancelled()
    except TimeIsUp:
        return True
    return False
