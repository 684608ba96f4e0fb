# SPDX-License-Identifier: BSD-3-Clause
"""The simulated plant: hysteresis, linear dynamics, amplifier and sensor."""
