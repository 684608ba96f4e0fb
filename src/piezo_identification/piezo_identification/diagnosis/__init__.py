# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of the effects that a model lacks, from its residual."""
