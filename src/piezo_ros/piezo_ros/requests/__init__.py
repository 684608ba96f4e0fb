# SPDX-License-Identifier: BSD-3-Clause
"""Goals and service calls: how they are asked for, and how goals are served."""
