# SPDX-License-Identifier: BSD-3-Clause
"""The designed experiments: the voltage waveforms and their sample periods."""
