# SPDX-License-Identifier: BSD-3-Clause
"""The stage node over a backend: limits, watchdog, waveforms, feedback."""
