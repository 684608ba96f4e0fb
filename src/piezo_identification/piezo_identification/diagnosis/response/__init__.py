# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of a measured frequency response, with linear effects only."""
