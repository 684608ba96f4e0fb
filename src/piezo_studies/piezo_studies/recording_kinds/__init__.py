# SPDX-License-Identifier: BSD-3-Clause
"""What identification makes of the kinds of recordings that laboratories have."""
