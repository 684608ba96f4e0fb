# SPDX-License-Identifier: BSD-3-Clause
"""The choices of a feedback design by name, and their defaults."""

METHODS = ("h_infinity", "pid", "pi")
SCALINGS = ("constant", "dynamic")

FEEDBACKS = ("h-infinity", "pi", "pid", "integral-resonant", "positive-position", "force-like",
             "repetitive")
"""Names of the laws that answer every sample."""

ALL = "all"
"""Name for all these laws, compared with one another."""

PEAK_SENSITIVITY = 2.0
"""Peak sensitivity of the worst stage, for which its gain margin is at least 2 and its phase margin
at least 29 degrees."""

DEFAULT_WEIGHTS = "default"

DISTURBANCE_HZ = 20.0
"""Bandwidth of the disturbances that the weights are made for (Hz), section 5.3.1."""

SAMPLE_RATE_HZ = 40_000.0
"""Rate of the stage's sample clock (Hz), as in the thesis."""


def check_choices(method: str, scaling: str) -> None:
    """Raise ValueError if the name of a method or of a scaling is unknown."""
    if method not in METHODS:
        raise ValueError(f'unknown method {method!r} of the feedback: use one of '
                         f'{", ".join(METHODS)}')
    if scaling not in SCALINGS:
        raise ValueError(f'unknown scaling {scaling!r}: use one of {", ".join(SCALINGS)}')
