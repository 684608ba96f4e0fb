# SPDX-License-Identifier: BSD-3-Clause
"""Run a model next to the stage in operation: detect changes, and find what explains them."""
