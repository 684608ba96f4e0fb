# SPDX-License-Identifier: BSD-3-Clause
"""Preparation of recordings for the estimators: waveforms, outliers, sign and settling."""
