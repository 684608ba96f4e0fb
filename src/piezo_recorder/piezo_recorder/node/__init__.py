# SPDX-License-Identifier: BSD-3-Clause
"""The node that records the stage's topics."""
