# SPDX-License-Identifier: BSD-3-Clause
"""Faults of the sensor and the hardware, for plant files that test the stage's guards."""
