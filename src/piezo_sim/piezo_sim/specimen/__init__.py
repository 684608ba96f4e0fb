# SPDX-License-Identifier: BSD-3-Clause
"""Specimens under the tip of a simulated stage."""
