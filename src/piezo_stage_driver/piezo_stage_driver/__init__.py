# SPDX-License-Identifier: BSD-3-Clause
"""The stage node over a backend: limits, watchdog, waveforms, feedback."""

from piezo_stage_driver.backends.backend import BackendFault

__all__ = ["BackendFault"]
