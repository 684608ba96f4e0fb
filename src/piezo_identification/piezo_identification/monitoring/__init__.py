# SPDX-License-Identifier: BSD-3-Clause
"""A model beside the stage in operation: what changed, since when, and what fits again."""
