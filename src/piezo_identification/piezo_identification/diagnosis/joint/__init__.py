# SPDX-License-Identifier: BSD-3-Clause
"""Models that compete on the recordings of their identification and on new ones together."""
