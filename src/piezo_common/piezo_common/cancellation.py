# SPDX-License-Identifier: BSD-3-Clause
"""Cancel long numerical work from outside, at any point in it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_check: ContextVar[Callable[[], object]] = ContextVar("check", default=lambda: None)


@contextmanager
def checking(check: Callable[[], object]) -> Iterator[None]:
    """Make `check_cancelled` call a function, which ends the work by an exception, in the context.

    This applies to the present thread, and to those in which `side_by_side` runs parts of the work.
    """
    token = _check.set(check)
    try:
        yield
    finally:
        _check.reset(token)


@contextmanager
def also_checking(check: Callable[[], object]) -> Iterator[None]:
    """Make `check_cancelled` call a function after those of the surrounding contexts."""
    before = _check.get()

    def both() -> None:
        before()
        check()

    with checking(both):
        yield


def check_cancelled() -> None:
    """Raise an exception if the work was cancelled; called in each iteration of an estimator."""
    _check.get()()
