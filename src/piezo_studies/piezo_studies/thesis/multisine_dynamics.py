# SPDX-License-Identifier: BSD-3-Clause
"""Section 3.4.2: electric and vibration dynamics from six sines and the identified hysteresis.

The simulated stage has the parameters of chapter 4, which differ slightly from those of chapter 3.
"""

import numpy as np

from piezo_common.picture_style import DIFFERENCE, MEASURED, MODELLED, label, new_figure
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_studies.baselines.armax_dynamics import estimate_dynamics_armax
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.identified_stage import DYNAMICS, identified_stage
from piezo_studies.thesis.laboratory import CLOCK_HZ, ROWS_LATE, record_stage

OFFSET_V = 24.0
AMPLITUDES_V = (3.0, 6.0, 3.0, 3.0, 3.0, 3.0)
FREQUENCIES_HZ = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0)
CLIMB_S, TONES_S = 0.5, 1.0
THESIS = (0.000474, 2.0 * np.pi * 453.5, 2.0 * np.pi * 792.7, 0.67, 0.081)
SECTION = "3.4.2"


def multisine_v():
    """Return a climb from rest, then the sines."""
    climb = np.arange(round(CLIMB_S * CLOCK_HZ)) / (CLIMB_S * CLOCK_HZ)
    time_s = np.arange(round(TONES_S * CLOCK_HZ)) / CLOCK_HZ
    tones_v = sum(
        amplitude_v * np.sin(2.0 * np.pi * frequency_hz * time_s)
        for amplitude_v, frequency_hz in zip(AMPLITUDES_V, FREQUENCIES_HZ, strict=True)
    )
    return np.concatenate([0.5 * OFFSET_V * (1.0 - np.cos(np.pi * climb)), OFFSET_V + tones_v])


def study():
    """Estimate the parameters by output error and by ARMAX, and the error of the simulation."""
    stage = identified_stage()
    record = record_stage("multisine", multisine_v())
    dynamics = estimate_dynamics(
        record, stage.creep, mode_count=2, delay=ROWS_LATE, hysteresis=stage.hysteresis).model
    armax, _ = estimate_dynamics_armax(
        record, stage.creep, stage.hysteresis, orders=(5, 5, 5), mode_count=2)
    prediction = predict(StageModel(stage.hysteresis, stage.creep, dynamics), record)
    quick = prediction.time_s > CLIMB_S + 0.1

    def rows(method, found):
        values = (found.time_constant_s, *found.mode_frequencies_rad_per_s, *found.damping_ratios)
        return [
            Row(SECTION, f"{name}, {method}", thesis, ours, unit, f"the true one: {true:.4g}")
            for (name, true, unit), thesis, ours in zip(DYNAMICS, THESIS, values, strict=True)
        ]

    return Study(
        [*rows("output error", dynamics), *rows("ARMAX (5, 5, 5)", armax),
         Row(SECTION, "e_y of the simulation", None, prediction.e_y_percent(quick), "%",
             "on the record that was fitted; Fig. 3.8 has no figure")],
        {"3.8": _draw(prediction, quick)},
    )


def _draw(prediction, quick):
    shown = np.flatnonzero(quick)[: round(0.03 * CLOCK_HZ)]
    time_ms = 1e3 * (prediction.time_s[shown] - prediction.time_s[shown[0]])
    measured_um, simulated_um = prediction.measured_um[shown], prediction.simulated_um[shown]
    mean_um = measured_um.mean()
    figure = new_figure(3.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(time_ms, measured_um - mean_um, **MEASURED)
    above.plot(time_ms, simulated_um - mean_um, **MODELLED)
    above.legend(ncols=2)
    label(above, y="displacement (um)")
    below.plot(time_ms, 1e3 * (measured_um - simulated_um), **DIFFERENCE)
    label(below, "time (ms)", "difference (nm)")
    return figure
