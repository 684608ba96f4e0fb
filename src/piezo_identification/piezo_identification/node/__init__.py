# SPDX-License-Identifier: BSD-3-Clause
"""The node that runs experiments, identification and diagnosis."""
