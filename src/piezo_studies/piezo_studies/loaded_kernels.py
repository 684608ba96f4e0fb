# SPDX-License-Identifier: BSD-3-Clause
"""Load the compiled kernels of a stage as this is imported, for processes that are then forked."""

from piezo_models.feedback_law.running_law import compile_law
from piezo_stage_driver.safety.sample_kernels import compile_kernels

compile_law()
compile_kernels()
