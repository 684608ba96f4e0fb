# SPDX-License-Identifier: BSD-3-Clause
"""Paths of two and three axes, and the voltages by which a coupled model follows them."""
