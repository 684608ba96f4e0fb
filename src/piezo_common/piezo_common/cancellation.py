# SPDX-License-Identifier: BSD-3-Clause
"""End long numerical work from outside, wherever in it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_check: ContextVar[Callable[[], object]] = ContextVar("check", default=lambda: None)


@contextmanager
def checking(check: Callable[[], object]) -> Iterator[None]:
    """Let `check_cancelled` call a function while the context lasts.

    It does so in this thread, and in those to which `side_by_side` gives a part of the work.

    Parameters
    ----------
    check : callable
        An exception of it ends the work.
    """
    token = _check.set(check)
    try:
        yield
    finally:
        _check.reset(token)


@contextmanager
def also_checking(check: Callable[[], object]) -> Iterator[None]:
    """Let `check_cancelled` call a function behind those of the contexts around."""
    before = _check.get()

    def both() -> None:
        before()
        check()

    with checking(both):
        yield


def check_cancelled() -> None:
    """Raise an exception if the work shall end; each iteration of an estimator calls this."""
    _check.get()()
