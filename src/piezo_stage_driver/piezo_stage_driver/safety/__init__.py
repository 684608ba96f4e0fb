# SPDX-License-Identifier: BSD-3-Clause
"""Protection of the amplifier from every client: limits, guards, and the supervisor."""
