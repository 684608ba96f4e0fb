# SPDX-License-Identifier: BSD-3-Clause
"""The commands identify, simulate and diagnose."""
