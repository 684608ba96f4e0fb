# SPDX-License-Identifier: BSD-3-Clause
"""Numerical failures of an estimator, reported as data that do not show what they are given for."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def failures_explained(stage: Callable[[], str], paths: Iterable[object]) -> Iterator[None]:
    """Turn a failure of linear algebra into an error that names the stage and the recordings.

    Raises
    ------
    ValueError
        Instead of `numpy.linalg.LinAlgError`.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        named = ", ".join(map(str, paths))
        raise ValueError(
            f"{stage()}: cannot be computed from {named} ({error}): a recording does not show "
            "what it was given for; look at each with check, and leave out those that do not fit"
        ) from error
