# SPDX-License-Identifier: BSD-3-Clause
"""The node that tracks references with the stage."""
