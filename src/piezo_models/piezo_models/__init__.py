# SPDX-License-Identifier: BSD-3-Clause
"""Numerical models of a piezo-actuated stage: hysteresis, creep, electric and vibration dynamics, inversion."""
