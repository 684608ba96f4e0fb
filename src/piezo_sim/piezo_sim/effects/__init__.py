# SPDX-License-Identifier: BSD-3-Clause
"""Effects that a plant file may add and that no model is told of."""
