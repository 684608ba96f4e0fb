# SPDX-License-Identifier: BSD-3-Clause
"""Simulation of recordings by a model, and what they do not tell beside any."""
