# SPDX-License-Identifier: BSD-3-Clause
"""Identification and diagnosis of measured devices, compared with published figures."""
