# SPDX-License-Identifier: BSD-3-Clause
"""Simulation of recordings by a model, and the nuisance parameters of recordings."""
