# SPDX-License-Identifier: BSD-3-Clause
"""How well diagnose names what hidden plants do: many drawn cases and their confusion table."""
