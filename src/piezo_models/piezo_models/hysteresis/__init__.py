# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of the stage: Preisach model, its inverse, and creep that depends on the branch."""
