# SPDX-License-Identifier: BSD-3-Clause
"""Feedback at the rate of the sample clock: a loop that is faster than the first mode."""
