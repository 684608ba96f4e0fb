# SPDX-License-Identifier: BSD-3-Clause
"""Breakdowns of the sensor and the hardware, for a plant file that tries the stage's guards."""
