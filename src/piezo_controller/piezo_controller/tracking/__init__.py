# SPDX-License-Identifier: BSD-3-Clause
"""Tracking runs: planned, played and measured."""
