# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of many recordings listed in a table, and the page that summarises them."""
