# SPDX-License-Identifier: BSD-3-Clause
"""Stages of two or three axes: one modal model of all axes."""
