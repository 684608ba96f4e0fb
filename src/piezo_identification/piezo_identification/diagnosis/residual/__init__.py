# SPDX-License-Identifier: BSD-3-Clause
"""What a model leaves of recordings: simulation, noise, outliers, and a weighted regression."""
