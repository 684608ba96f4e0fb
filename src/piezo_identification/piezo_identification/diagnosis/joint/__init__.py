# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of models on the recordings of their identification and on new ones together."""
