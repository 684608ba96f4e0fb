# SPDX-License-Identifier: BSD-3-Clause
"""The stage node over a backend protocol: limits, watchdog, sample blocks, waveforms, feedforward and feedback."""
