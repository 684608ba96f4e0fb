# SPDX-License-Identifier: BSD-3-Clause
"""What a user chooses of a feedback design, by name, and what is taken where nothing is chosen."""

METHODS = ("h_infinity", "pid", "pi")
SCALINGS = ("constant", "dynamic")

DEFAULT_WEIGHTS = "default"

DISTURBANCE_HZ = 20.0
"""Bandwidth of the disturbances that the weights are made for, section 5.3.1."""

SAMPLE_RATE_HZ = 40_000.0
"""Sample clock of the stage, that of the thesis."""
