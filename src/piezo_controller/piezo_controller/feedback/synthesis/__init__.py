# SPDX-License-Identifier: BSD-3-Clause
"""Synthesis of feedback controllers: H-infinity, D-K iteration, PID and PI."""
