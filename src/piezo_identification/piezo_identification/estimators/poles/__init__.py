# SPDX-License-Identifier: BSD-3-Clause
"""Poles of linear dynamics: what responds with them, and how vector fitting finds them."""
