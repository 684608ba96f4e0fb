# SPDX-License-Identifier: BSD-3-Clause
"""The names of the methods that fit recorded dynamics."""

METHODS = ("output-error", "armax")
"""Each estimates electric and vibration dynamics from samples."""
