# SPDX-License-Identifier: BSD-3-Clause
"""Executables that have moved to another package."""

from piezo_ros.forwarding import forward


def measured() -> None:
    """Run the study of measured devices of ``piezo_studies``."""
    forward("piezo_studies", "measured")
