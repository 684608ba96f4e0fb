# SPDX-License-Identifier: BSD-3-Clause
"""Measure an unknown stage, and fit the other experiments to it."""
