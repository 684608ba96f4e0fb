# SPDX-License-Identifier: BSD-3-Clause
"""Relative errors of a prediction: of the whole, of its slow and of its fast branches."""

import numpy as np

from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.prediction.prediction import Prediction, predict
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording


def unseen_errors(model: StageModel, recording: Recording) -> dict[str, float]:
    """Return the errors by the sensor on a recording that was not fitted.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    dict of str to float
        `e_y_percent` of the whole, `hysteresis_e_y_percent` of the slow branches and
        `dynamics_e_y_percent` of the fast ones, as far as there are any.
    """
    return errors_of(predict(model, recording))


def errors_of(prediction: Prediction) -> dict[str, float]:
    """Return the errors of a prediction, named as those of `unseen_errors`.

    Parameters
    ----------
    prediction : Prediction

    Returns
    -------
    dict of str to float
    """
    errors = {"e_y_percent": prediction.e_y_percent()}
    slow = slow_branches(prediction.time_s, prediction.voltage_v)
    for name, part in (("hysteresis", slow), ("dynamics", ~slow)):
        part = part & prediction.good
        if np.ptp(prediction.measured_um[part]) if part.any() else 0.0:
            errors[f"{name}_e_y_percent"] = prediction.e_y_percent(part)
    return errors
