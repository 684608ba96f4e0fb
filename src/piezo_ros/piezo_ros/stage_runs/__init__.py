# SPDX-License-Identifier: BSD-3-Clause
"""Runs of the stage as a client sees them: fed, answered, recorded, watched and accounted for."""
