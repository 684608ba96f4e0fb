# SPDX-License-Identifier: BSD-3-Clause
"""Identification of stages of two or three axes that share their modes."""
