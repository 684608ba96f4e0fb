# SPDX-License-Identifier: BSD-3-Clause
"""Creep, electric lag and vibration: linear dynamics, their sampling and their inverse."""
