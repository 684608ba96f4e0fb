# SPDX-License-Identifier: BSD-3-Clause
"""Study of the accuracy with fewer levels, shorter recordings and lower sample rates."""
