# SPDX-License-Identifier: BSD-3-Clause
"""How soon the monitor finds a change of the stage, and how often it errs in an hour without."""
