# SPDX-License-Identifier: BSD-3-Clause
"""Additional effects for plant files, which models do not declare."""
