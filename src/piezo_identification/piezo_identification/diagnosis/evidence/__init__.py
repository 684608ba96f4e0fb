# SPDX-License-Identifier: BSD-3-Clause
"""Evidence for a verdict: tests of the residual, entries of the effects, outliers."""
