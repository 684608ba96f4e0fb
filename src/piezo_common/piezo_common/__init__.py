# SPDX-License-Identifier: BSD-3-Clause
"""What every package may use: files, command lines, report pages, plot style and progress."""
