# SPDX-License-Identifier: BSD-3-Clause
"""Reproduction of the numerical studies in chapters 2 to 5 of the thesis."""
