# SPDX-License-Identifier: BSD-3-Clause
"""Voltages that make the model follow a reference."""
