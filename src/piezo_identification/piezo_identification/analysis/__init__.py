# SPDX-License-Identifier: BSD-3-Clause
"""What recordings show before any model is asked."""
