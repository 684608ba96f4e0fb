# SPDX-License-Identifier: BSD-3-Clause
"""Tracking control of a piezo-actuated stage: inverse feedforward, multirate feedback."""
