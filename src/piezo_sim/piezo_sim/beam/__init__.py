# SPDX-License-Identifier: BSD-3-Clause
"""Effects of the plant `beam`, whose mathematical form no model of the suite shares."""
