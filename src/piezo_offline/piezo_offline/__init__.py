# SPDX-License-Identifier: BSD-3-Clause
"""Recordings, models, verdicts and controllers without ROS: in Python, and as `piezo`."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_offline.comparison import Comparison, compare
    from piezo_offline.files import load_controller, load_model, save_controller, save_model
    from piezo_offline.given_data import DataWarning, read
    from piezo_offline.steps import (
        design,
        diagnose,
        extend,
        identify,
        plot_residuals,
        simulate,
    )

_HOMES = {
    "Comparison": "comparison",
    "compare": "comparison",
    "load_controller": "files",
    "load_model": "files",
    "save_controller": "files",
    "save_model": "files",
    "DataWarning": "given_data",
    "read": "given_data",
    "design": "steps",
    "diagnose": "steps",
    "extend": "steps",
    "identify": "steps",
    "plot_residuals": "steps",
    "simulate": "steps",
}
__getattr__, __dir__ = lazy_exports(__name__, _HOMES)

__all__ = [
    "Comparison", "DataWarning", "compare", "design", "diagnose", "extend", "identify",
    "load_controller", "load_model", "plot_residuals", "read", "save_controller", "save_model",
    "simulate",
]
