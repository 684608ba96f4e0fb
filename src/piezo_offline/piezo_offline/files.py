# SPDX-License-Identifier: BSD-3-Clause
"""The files of models and controllers, for those who work with `piezo_offline` alone."""

from piezo_controller.feedback.controller_file import load_controller, save_controller
from piezo_models.model_file import load_model, save_model

__all__ = ["load_controller", "load_model", "save_controller", "save_model"]
