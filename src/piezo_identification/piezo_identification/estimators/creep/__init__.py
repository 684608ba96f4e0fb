# SPDX-License-Identifier: BSD-3-Clause
"""Estimate the creep from square waves and from any other slow recordings."""
