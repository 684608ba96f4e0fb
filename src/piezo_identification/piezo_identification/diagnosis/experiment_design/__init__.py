# SPDX-License-Identifier: BSD-3-Clause
"""From rival explanations to the recording that tells them apart."""
