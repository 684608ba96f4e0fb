# SPDX-License-Identifier: BSD-3-Clause
"""Readers of recordings, whatever file they come in."""
