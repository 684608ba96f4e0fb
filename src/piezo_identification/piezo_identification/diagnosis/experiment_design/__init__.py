# SPDX-License-Identifier: BSD-3-Clause
"""Design of the recording that distinguishes between alternative explanations."""
