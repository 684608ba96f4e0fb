# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories that the stage is to follow."""
