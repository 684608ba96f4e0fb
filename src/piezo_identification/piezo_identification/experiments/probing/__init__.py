# SPDX-License-Identifier: BSD-3-Clause
"""Measure a stage one knows nothing about, and fit the other experiments to it."""
