# SPDX-License-Identifier: BSD-3-Clause
"""A simulated piezo-actuated stage behind the stage node."""
