# SPDX-License-Identifier: BSD-3-Clause
"""Predict the displacement of a recording with a model, and compute the error."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_identification.prediction.prediction import Prediction, predict
    from piezo_identification.prediction.prediction_errors import errors_of, unseen_errors

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "Prediction", "errors_of", "predict", "unseen_errors",
]
