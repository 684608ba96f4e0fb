# SPDX-License-Identifier: BSD-3-Clause
"""The feedback: its design, its analysis and its evaluation every tick."""
