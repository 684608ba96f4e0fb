# SPDX-License-Identifier: BSD-3-Clause
"""Study of paths and cross-coupling of the simulated XY stage with its identified model."""
