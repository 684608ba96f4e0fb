# SPDX-License-Identifier: BSD-3-Clause
"""Estimators of the linear dynamics from a measured frequency response."""
