# SPDX-License-Identifier: BSD-3-Clause
"""The designed experiments: which voltage is played, and how fast."""
