# SPDX-License-Identifier: BSD-3-Clause
"""Drive a piezo stage from Python and from the command line."""
