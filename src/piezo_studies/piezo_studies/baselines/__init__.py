# SPDX-License-Identifier: BSD-3-Clause
"""Methods of the thesis that only studies and tests use."""
