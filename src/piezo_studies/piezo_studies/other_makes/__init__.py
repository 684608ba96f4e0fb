# SPDX-License-Identifier: BSD-3-Clause
"""Study of stages of other makes, whose mathematical form differs from that of the models."""
