# SPDX-License-Identifier: BSD-3-Clause
"""Recordings made ready for the estimators: waveforms, outliers, sign and settling."""
