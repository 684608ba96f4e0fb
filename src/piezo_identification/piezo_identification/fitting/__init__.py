# SPDX-License-Identifier: BSD-3-Clause
"""Fits of the whole model with its effects to several recordings, and the evidence for each."""
