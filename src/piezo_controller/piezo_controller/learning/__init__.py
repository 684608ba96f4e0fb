# SPDX-License-Identifier: BSD-3-Clause
"""Feedforward that learns from the errors of earlier periods."""
