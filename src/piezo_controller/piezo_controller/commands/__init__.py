# SPDX-License-Identifier: BSD-3-Clause
"""The commands design and scan."""
