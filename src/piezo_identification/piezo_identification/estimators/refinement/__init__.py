# SPDX-License-Identifier: BSD-3-Clause
"""All components fitted together on all recordings."""
