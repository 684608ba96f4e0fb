# SPDX-License-Identifier: BSD-3-Clause
"""Relative errors of a prediction: on all samples, on slow branches and on fast branches."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from piezo_common.arrays import BoolArray
from piezo_identification.conditioning.segments import Recordings, listed
from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.prediction.prediction import Prediction, predict
from piezo_models.cascade import StageModel
from piezo_models.measures import e_y_percent

LEAST_MOTION = 0.02
"""Smallest standard deviation of voltage and displacement on slow or fast branches, relative to all
samples, for which their error is reported. Without motion, relative errors are large."""

NAMES = {"e_y_percent": "whole recording", "hysteresis_e_y_percent": "slow branches (hysteresis)",
         "dynamics_e_y_percent": "fast branches (dynamics)"}
"""What the errors of `unseen_errors` are of, for users."""


def unseen_errors(model: StageModel, recordings: Recordings) -> dict[str, float]:
    """Return the errors by the sensor on recordings that were not fitted.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Recordings without gaps.

    Returns
    -------
    dict of str to float
        `e_y_percent` for all samples, `hysteresis_e_y_percent` for slow branches and
        `dynamics_e_y_percent` for fast ones, if the stage moves in them.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> time_s = 0.01 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(3.0 * time_s)
    >>> stage, model = (StageModel(line, CreepDynamics(), ElectricVibrationDynamics(lag_s))
    ...                 for lag_s in (0.02, 0.0))
    >>> errors = unseen_errors(model, recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 0.01)}))
    >>> print(f"{errors['e_y_percent']:.1f} %")
    7.8 %
    """
    return errors_of([predict(model, recording) for recording in listed(recordings)])


def named_errors(errors: Mapping[str, Any], of: str = "") -> Iterator[tuple[str, float]]:
    """Yield what each relative error of a model is of, and its value in percent."""
    for name, value in errors.items():
        what = NAMES.get(name, name.replace("_", " "))
        if isinstance(value, dict):
            yield from named_errors(value, what)
        elif name.endswith("_percent") or of:
            yield f"{of}: {what}" if of else what, value


def errors_of(predictions: Sequence[Prediction]) -> dict[str, float]:
    """Return the errors of predictions together, named as those of `unseen_errors`.

    They are of the stretches of one experiment, and each has its own offset.
    """
    errors = {"e_y_percent": _joint_e_y_percent(predictions, [each.good for each in predictions])}
    slow = [slow_branches(each.time_s, each.voltage_v) for each in predictions]
    fast = [~mask for mask in slow]
    for name, masks in (("hysteresis", slow), ("dynamics", fast)):
        parts = [mask & each.good for mask, each in zip(masks, predictions, strict=True)]
        if any(_moves(each, part) for part, each in zip(parts, predictions, strict=True)):
            errors[f"{name}_e_y_percent"] = _joint_e_y_percent(predictions, parts)
    return errors


def _moves(prediction: Prediction, part: BoolArray) -> bool:
    """Return whether voltage and displacement move notably in a part."""
    return bool(part.any()) and all(
        np.std(signal[part]) > LEAST_MOTION * np.std(signal)
        for signal in (prediction.voltage_v, prediction.measured_um))


def _joint_e_y_percent(predictions: Sequence[Prediction], parts: Sequence[BoolArray]) -> float:
    """Return the relative error (4.20) over parts of predictions, with offsets removed."""
    measured_um, simulated_um = (
        np.concatenate([values[part] - values[part].mean()
                        for values, part in zip(signals, parts, strict=True) if part.any()])
        for signals in ([each.measured_um for each in predictions],
                        [each.simulated_um for each in predictions]))
    return e_y_percent(measured_um, simulated_um)
