# SPDX-License-Identifier: BSD-3-Clause
"""Study of the identification from all kinds of laboratory recordings."""
