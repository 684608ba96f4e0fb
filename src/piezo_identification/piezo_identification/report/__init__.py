# SPDX-License-Identifier: BSD-3-Clause
"""HTML reports of identification, simulation and check, and their shared figures."""
