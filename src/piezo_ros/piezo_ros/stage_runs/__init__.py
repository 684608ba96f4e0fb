# SPDX-License-Identifier: BSD-3-Clause
"""Runs of the stage for a client: play, respond, record, supervise, and count deviations."""
