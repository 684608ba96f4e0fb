# SPDX-License-Identifier: BSD-3-Clause
"""End long numerical work from outside, wherever in it."""

from contextlib import contextmanager
from contextvars import ContextVar

_check = ContextVar("check", default=lambda: None)


@contextmanager
def checking(check):
    """Have `check_cancelled` call a function meanwhile, in this thread.

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


def check_cancelled():
    """Called by the iterations of the estimators: raises where the work shall end."""
    _check.get()()
