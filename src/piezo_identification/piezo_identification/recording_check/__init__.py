# SPDX-License-Identifier: BSD-3-Clause
"""Check recordings and their suitability for experiments, before a model is fitted."""
