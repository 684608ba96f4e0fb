# SPDX-License-Identifier: BSD-3-Clause
"""Test whether each component of a model fits its own recording down to the noise."""
