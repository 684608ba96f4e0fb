# SPDX-License-Identifier: BSD-3-Clause
"""What a user chooses of a feedback design, by name, and what is taken where nothing is chosen."""

METHODS = ("h_infinity", "pid", "pi")
SCALINGS = ("constant", "dynamic")

FEEDBACKS = ("h-infinity", "pi", "pid", "integral-resonant", "positive-position", "force-like",
             "repetitive")
"""Laws that answer every sample, by the words that people ask for them."""

ALL = "all"
"""These laws beside each other."""

PEAK_SENSITIVITY = 2.0
"""Where the worst stage has this peak, its gain margin is at least 2 and its phase margin at least
29 degrees."""

DEFAULT_WEIGHTS = "default"

DISTURBANCE_HZ = 20.0
"""Bandwidth of the disturbances that the weights are made for, section 5.3.1."""

SAMPLE_RATE_HZ = 40_000.0
"""Sample clock of the stage, that of the thesis."""
