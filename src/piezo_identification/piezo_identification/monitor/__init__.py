# SPDX-License-Identifier: BSD-3-Clause
"""A model beside the stage in operation, and tests that tell when it no longer fits."""
