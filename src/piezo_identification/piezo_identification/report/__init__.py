# SPDX-License-Identifier: BSD-3-Clause
"""Pages of identification, simulation and check, and the pictures that they share."""
