# SPDX-License-Identifier: BSD-3-Clause
"""From alternative explanations to the recording that tells them apart."""
