# SPDX-License-Identifier: BSD-3-Clause
"""Recordings, models, verdicts and controllers without ROS: in Python, and as `piezo`."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_controller.axes.scan import scan
    from piezo_controller.feedback.controller_file import load_controller, save_controller
    from piezo_offline.comparison import Comparison, compare
    from piezo_offline.files import load_model, save_model
    from piezo_offline.python_data import DataWarning, read
    from piezo_offline.steps import design, diagnose, extend, identify, plot_residuals, simulate

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "Comparison", "DataWarning", "compare", "design", "diagnose", "extend", "identify",
    "load_controller", "load_model", "plot_residuals", "read", "save_controller", "save_model",
    "scan", "simulate",
]
