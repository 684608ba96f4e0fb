# SPDX-License-Identifier: BSD-3-Clause
"""Models of a piezo-actuated stage: hysteresis, creep, dynamics, inversion."""
