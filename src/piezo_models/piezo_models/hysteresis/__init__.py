# SPDX-License-Identifier: BSD-3-Clause
"""Preisach hysteresis, its inverse, and creep that depends on the branch."""
