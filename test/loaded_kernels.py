# SPDX-License-Identifier: BSD-3-Clause
"""Load the compiled kernels of a feedback law as this is imported, once for all later forks."""

from piezo_models.feedback_law.running_law import compile_law

compile_law()
