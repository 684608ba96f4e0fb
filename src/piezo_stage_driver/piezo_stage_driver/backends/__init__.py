# SPDX-License-Identifier: BSD-3-Clause
"""The hardware backends of the stage node, and their registry."""
