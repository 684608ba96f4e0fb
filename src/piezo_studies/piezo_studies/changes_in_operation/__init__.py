# SPDX-License-Identifier: BSD-3-Clause
"""How soon the monitor finds that a model's error doubled, and how often it errs in ten hours."""
