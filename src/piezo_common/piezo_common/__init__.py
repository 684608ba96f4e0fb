# SPDX-License-Identifier: BSD-3-Clause
"""Helpers for all packages: files, command lines, report pages, plot style and progress."""
