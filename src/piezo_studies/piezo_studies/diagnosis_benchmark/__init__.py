# SPDX-License-Identifier: BSD-3-Clause
"""Benchmark of `diagnose` on many random plants with hidden effects, with a confusion table."""
