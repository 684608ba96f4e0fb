# SPDX-License-Identifier: BSD-3-Clause
"""ARMAX models of fast records, as the thesis estimates its dynamics."""
