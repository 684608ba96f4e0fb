# SPDX-License-Identifier: BSD-3-Clause
"""Readers of recordings in files of any kind."""
