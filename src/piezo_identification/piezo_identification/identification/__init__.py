# SPDX-License-Identifier: BSD-3-Clause
"""The sequence of estimators that turns recordings into a stage model."""
