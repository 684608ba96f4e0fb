# SPDX-License-Identifier: BSD-3-Clause
"""The commands convert, repair and report, and the options of all that read data."""
