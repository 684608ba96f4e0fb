# SPDX-License-Identifier: BSD-3-Clause
"""Whether each component of a model fits its own recording as well as the noise allows."""
