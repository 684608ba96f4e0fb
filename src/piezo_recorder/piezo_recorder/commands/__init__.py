# SPDX-License-Identifier: BSD-3-Clause
"""The commands convert, repair and report, and the options of all commands that read data."""
