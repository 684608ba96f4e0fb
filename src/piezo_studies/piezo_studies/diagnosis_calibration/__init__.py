# SPDX-License-Identifier: BSD-3-Clause
"""Calibration of the probabilities and intervals of diagnoses on hundreds of short recordings."""
