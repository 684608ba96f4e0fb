# SPDX-License-Identifier: BSD-3-Clause
"""Estimators of the Preisach density."""
