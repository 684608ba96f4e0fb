# SPDX-License-Identifier: BSD-3-Clause
"""The demo: identify a simulated stage, track, diagnose, track better, and report."""
