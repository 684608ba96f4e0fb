# SPDX-License-Identifier: BSD-3-Clause
"""Estimators of the electric and vibration dynamics from samples."""
