# SPDX-License-Identifier: BSD-3-Clause
"""What stands between every client and the amplifier: limits, guards, and the supervisor."""
