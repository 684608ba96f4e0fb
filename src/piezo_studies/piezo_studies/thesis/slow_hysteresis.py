# SPDX-License-Identifier: BSD-3-Clause
"""Section 2.4.1: the hysteresis of the stage from harmonics of rising amplitude at 1 kHz.

First, the stage plays one cycle over the range and rests, so that creep from relays below 0 V has
decayed.
"""

from functools import cache

import numpy as np

from piezo_common.picture_style import DIFFERENCE, MEASURED, MODELLED, label, new_figure
from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.measures import e_rms_percent, e_y_percent
from piezo_studies.baselines.polynomial_drift import remove_polynomial_drift
from piezo_studies.baselines.relay_regression import accumulate
from piezo_studies.baselines.sampling_rules import sample_by_voltage
from piezo_studies.baselines.svd_estimate import density_by_svd, truncated_svd
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.laboratory import record_stage
from piezo_studies.thesis.pictures import draw_estimate

LEVELS = 60
HIGHEST_V = 60.0
HARMONIC_PERIOD_S = 2.0
CLOCK_HZ = 1000.0
LEAST_SINGULAR_VALUE = 2.5
REST_S = 20.0
SECTION = "2.4.1"


def full_swing_v():
    """Return one second of a sine between 0 and the highest voltage."""
    return stair_harmonics(np.arange(round(CLOCK_HZ)) / CLOCK_HZ, np.array([HIGHEST_V]), 1.0)


def preparation_v():
    """Return a full swing, then rest."""
    return np.append(full_swing_v(), np.zeros(round(REST_S * CLOCK_HZ)))


@cache
def identified_hysteresis():
    """Return the density by truncated SVD, and the fitted samples."""
    levels_v = np.linspace(0.0, HIGHEST_V, LEVELS + 1)
    time_s = np.arange(round(LEVELS * HARMONIC_PERIOD_S * CLOCK_HZ)) / CLOCK_HZ
    voltage_v = stair_harmonics(time_s, stair_amplitudes(LEVELS, HIGHEST_V), HARMONIC_PERIOD_S)
    played = record_stage("harmonics", voltage_v, preparation_v(), clock_hz=CLOCK_HZ)
    played = played.select(played.playing)
    starts = np.arange(LEVELS) * round(HARMONIC_PERIOD_S * CLOCK_HZ)
    output_um, _ = remove_polynomial_drift(time_s, played.displacement_um, starts)
    output_um = output_um - output_um[starts].mean()
    equations = accumulate(voltage_v, output_um, levels_v)
    decomposition = truncated_svd(equations, least=LEAST_SINGULAR_VALUE)
    return density_by_svd(decomposition, voltage_v, levels_v), voltage_v, output_um


def study():
    """Compute the singular values, and the errors of the identified hysteresis at 1 Hz."""
    estimate, voltage_v, output_um = identified_hysteresis()
    values = estimate.singular_values
    nonzero = values[values > 1e-9 * values[0]]
    model = estimate.model()
    # Truncation gives some negative densities, with which the hysteresis has no inverse.
    clipped = PreisachModel(0.0, HIGHEST_V, np.maximum(model.density_um_per_v2, 0.0))
    smooth = smoothed_density(
        voltage_v, output_um, estimate.levels_v, sample_by_voltage(voltage_v, estimate.levels_v)
    ).model()
    fitted_um = model.simulate(voltage_v)
    loop_v, loop_um = _settled_loop(full_swing_v())
    simulated_um = model.simulate(np.tile(loop_v, 2))[loop_v.size :]
    reference_um = 22.0 - 20.0 * np.cos(2.0 * np.pi * np.arange(loop_v.size) / loop_v.size)
    tracked_um, clipped_tracked_um = (
        _settled_loop(inverse.invert(np.tile(reference_um, 2))[reference_um.size :])[1]
        for inverse in (smooth, clipped)
    )
    rows = [
        Row(SECTION, "largest singular value of M", 2.541e7, values[0], "1"),
        Row(SECTION, "least singular value of M above zero", 0.734, nonzero[-1], "1"),
        Row(SECTION, "condition number of M", 3.462e7, nonzero[0] / nonzero[-1], "1"),
        Row(SECTION, "singular values kept, those above 2.5", None, estimate.rank, "1"),
        Row(SECTION, "least density over the largest", None,
            100.0 * model.density_um_per_v2.min() / model.density_um_per_v2.max(), "%",
            "the thesis has none below zero; a staircase of relays fits no voltage between levels"),
        Row(SECTION, "e_y of the fit", None, e_y_percent(output_um, fitted_um), "%",
            "creep of the stage remains in it"),
        Row(SECTION, "e_y at 1 Hz, unseen", None, e_y_percent(loop_um, simulated_um), "%",
            "Fig. 2.8 (a) has no figure; creep remains"),
        Row(SECTION, "e_rms of its inverse at 1 Hz, offset removed", None,
            e_rms_percent(reference_um, clipped_tracked_um, remove_offset=True), "%",
            "negative cells set to zero, which the inverse needs"),
        Row(SECTION, "e_rms of the inverse at 1 Hz, smoothed non-negative fit", None,
            e_rms_percent(reference_um, tracked_um, remove_offset=True), "%",
            "this one is in Fig. 2.8 (b), which has no figure"),
    ]
    return Study(rows, {
        "2.7": draw_estimate(estimate, LEAST_SINGULAR_VALUE),
        "2.8": _draw_validation(loop_v, loop_um, simulated_um, reference_um, tracked_um),
    })


def _settled_loop(period_v):
    """Return the last of ten periods, without the mean of the displacement."""
    played = record_stage("loop", np.tile(period_v, 10), preparation_v(), clock_hz=CLOCK_HZ)
    last = slice(-period_v.size, None)
    displacement_um = played.displacement_um[last]
    return played.voltage_v[last], displacement_um - displacement_um.mean()


def _draw_validation(loop_v, loop_um, simulated_um, reference_um, tracked_um):
    figure = new_figure(3.4)
    (left, right), (left_error, right_error) = figure.subplots(2, 2, height_ratios=(3, 1))
    simulated_um = simulated_um - simulated_um.mean()
    left.plot(loop_v, loop_um, **MEASURED)
    left.plot(loop_v, simulated_um, **MODELLED)
    left.legend()
    label(left, y="displacement (um)", title="loop at 1 Hz")
    left_error.plot(loop_v, loop_um - simulated_um, **DIFFERENCE)
    label(left_error, "voltage (V)", "error (um)")
    reference_um = reference_um - reference_um.mean()
    right.plot(reference_um, tracked_um, **MODELLED)
    label(right, y="displacement (um)", title="with the inverse, at 1 Hz")
    right_error.plot(reference_um, reference_um - tracked_um, **DIFFERENCE)
    label(right_error, "desired displacement (um)", "error (um)")
    return figure
