# SPDX-License-Identifier: BSD-3-Clause
"""The hardware behind the stage node, and how a backend is found."""
