# SPDX-License-Identifier: BSD-3-Clause
"""Many recordings, diagnosed one by one from a table, and the page that sums them up."""
