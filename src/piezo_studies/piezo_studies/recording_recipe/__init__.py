# SPDX-License-Identifier: BSD-3-Clause
"""What fewer levels, shorter recordings and lower rates cost in accuracy."""
