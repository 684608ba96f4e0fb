# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of sets of effects on a validation set that no fit has used."""
