# SPDX-License-Identifier: BSD-3-Clause
"""Recordings with the drive of the modes in place of the voltage."""

from dataclasses import replace

import numpy as np

from piezo_identification.axes.predict_axes import (
    circumstances_of,
    creep_decays,
    fitted,
    simulated_um,
)
from piezo_identification.axes.spectra import played_lines
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording


def with_drive(model: CoupledModel, recording: AxesRecording) -> AxesRecording:
    """Return a recording with the drive of the modes as its voltage, without earlier creep.

    The drive of a periodic voltage is reduced to the lines of the voltage: between them hysteresis
    adds too little to determine a response.
    """
    periods = recording.periods or 1
    voltage_v = recording.voltage_v.reshape(periods, -1, len(model.axes)).mean(axis=0)
    circumstances = circumstances_of(model, recording)
    drive_v = model.drive_v(voltage_v, bool(recording.periods), circumstances.pasts)
    resting = np.ptp(voltage_v, axis=0) == 0.0
    drive_v[:, resting] = drive_v[0, resting]  # without the rounding of the creep
    if recording.periods:
        lines = np.fft.rfft(drive_v, axis=0)
        lines[~played_lines(np.fft.rfft(voltage_v, axis=0))] = 0.0
        drive_v = drive_v.mean(axis=0) + np.fft.irfft(lines, len(drive_v), axis=0)
    crept_um = fitted(creep_decays(model, recording), recording.displacement_um - simulated_um(
        model, recording, circumstances))
    return replace(recording, voltage_v=np.tile(drive_v, (periods, 1)),
                   displacement_um=recording.displacement_um - crept_um)
