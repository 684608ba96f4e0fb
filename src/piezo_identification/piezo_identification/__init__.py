# SPDX-License-Identifier: BSD-3-Clause
"""Identification of a piezo-actuated stage: experiments, estimators, node, offline commands."""
