# SPDX-License-Identifier: BSD-3-Clause
"""Goals and service calls: clients for both, and servers of goals."""
