# SPDX-License-Identifier: BSD-3-Clause
"""The numerical studies of the thesis' chapters 2 to 5, done again."""
