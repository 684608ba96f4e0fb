# SPDX-License-Identifier: BSD-3-Clause
"""Studies with the suite: demo, thesis, measured devices, diagnosis benchmark."""
