# SPDX-License-Identifier: BSD-3-Clause
"""Analysis of recordings without a model."""
