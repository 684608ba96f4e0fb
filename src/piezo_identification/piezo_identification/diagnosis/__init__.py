# SPDX-License-Identifier: BSD-3-Clause
"""From the residual of a model to the effect that it lacks."""
