# SPDX-License-Identifier: BSD-3-Clause
"""Models with another actuator, and recordings with the drive of the modes as their voltage."""

from dataclasses import replace

import numpy as np

from piezo_identification.axes.predict_axes import (
    circumstances_of,
    creep_decays,
    driven_v,
    fitted,
    mean_period,
    simulated_um,
)
from piezo_identification.axes.spectra import played_lines
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording


def with_actuator(model: CoupledModel, axis: int, actuator: Actuator) -> CoupledModel:
    """Return a model with another actuator of one axis."""
    actuators = list(model.actuators or (Actuator(),) * len(model.axes))
    actuators[axis] = actuator
    return replace(model, actuators=tuple(actuators))


def with_drive(model: CoupledModel, recording: AxesRecording) -> AxesRecording:
    """Return a recording with the drive of the modes as its voltage, without earlier creep.

    The drive of a periodic voltage is reduced to the lines of the voltage: between them hysteresis
    adds too little to determine a response.
    """
    voltage_v = mean_period(recording, recording.voltage_v)
    circumstances = circumstances_of(model, recording)
    drive_v = driven_v(model, recording, circumstances)
    resting = np.ptp(voltage_v, axis=0) == 0.0
    drive_v[:, resting] = drive_v[0, resting]  # without the rounding of the creep
    if recording.periods:
        lines = np.fft.rfft(drive_v, axis=0)
        lines[~played_lines(np.fft.rfft(voltage_v, axis=0))] = 0.0
        drive_v = drive_v.mean(axis=0) + np.fft.irfft(lines, len(drive_v), axis=0)
    crept_um = fitted(creep_decays(model, recording), recording.displacement_um - simulated_um(
        model, recording, circumstances))
    return replace(recording, voltage_v=np.tile(drive_v, (recording.periods or 1, 1)),
                   displacement_um=recording.displacement_um - crept_um)
