# SPDX-License-Identifier: BSD-3-Clause
"""Executables that have moved to another package."""

from piezo_ros.forwarding import forward


def demo() -> None:
    """Run the demo of ``piezo_studies``."""
    forward("piezo_studies", "demo")


def diagnose_suite() -> None:
    """Run the diagnosis benchmark of ``piezo_studies``."""
    forward("piezo_studies", "diagnose_suite")
