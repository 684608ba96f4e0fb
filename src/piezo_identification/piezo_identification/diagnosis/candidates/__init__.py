# SPDX-License-Identifier: BSD-3-Clause
"""The effects that may explain a residual: what a recording shows of them, and their fits."""
