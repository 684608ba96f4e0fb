# SPDX-License-Identifier: BSD-3-Clause
"""The report of a diagnosis: its sentences, tables and figures."""
