# SPDX-License-Identifier: BSD-3-Clause
"""Section 3.4.1: drift by a polynomial, and the hysteresis from samples chosen by voltage."""

import numpy as np

from piezo_common.picture_style import BLUE, GREY, VERMILION, label, new_figure
from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_studies.baselines.polynomial_drift import remove_polynomial_drift
from piezo_studies.baselines.relay_regression import accumulate
from piezo_studies.baselines.sampling_rules import stair_sample_times
from piezo_studies.baselines.svd_estimate import density_by_svd, truncated_svd
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.laboratory import record_stage
from piezo_studies.thesis.pictures import draw_estimate
from piezo_studies.thesis.slow_hysteresis import CLOCK_HZ, HIGHEST_V, LEVELS, preparation_v

HARMONIC_PERIOD_S = 100.0 / 60.0
LEAST_SINGULAR_VALUE = 1.2
DRIFT = np.polynomial.Polynomial([-0.013, 0.0127, 0.000121])
"""Drift (um) as a function of time (s), eq. (3.21)."""

SECTION = "3.4.1"


def study():
    """Compute rank, condition, drift, and the error of the fit."""
    step_v = HIGHEST_V / LEVELS
    levels_v = np.linspace(0.0, HIGHEST_V, LEVELS + 1)
    amplitudes_v = stair_amplitudes(LEVELS, HIGHEST_V, below_the_top=0.5)
    middles_v = levels_v[1:] - 0.5 * step_v
    sampled_s = stair_sample_times(amplitudes_v, HARMONIC_PERIOD_S, middles_v)
    sampled_v = stair_harmonics(sampled_s, amplitudes_v, HARMONIC_PERIOD_S)
    time_s = np.arange(round(LEVELS * HARMONIC_PERIOD_S * CLOCK_HZ) + 1) / CLOCK_HZ
    voltage_v = stair_harmonics(time_s, amplitudes_v, HARMONIC_PERIOD_S)
    played = record_stage("harmonics", voltage_v, preparation_v(), clock_hz=CLOCK_HZ)
    displacement_um = played.displacement_um[played.playing]
    starts = np.round(np.arange(LEVELS) * HARMONIC_PERIOD_S * CLOCK_HZ).astype(int)
    steady_um, drift = remove_polynomial_drift(time_s, displacement_um, starts)
    steady_um = steady_um - steady_um[starts].mean()
    _, known = remove_polynomial_drift(time_s, steady_um + DRIFT(time_s), starts)

    output_um = np.interp(sampled_s, time_s, steady_um)
    equations = accumulate(sampled_v, output_um, levels_v)
    estimate = density_by_svd(
        truncated_svd(equations, least=LEAST_SINGULAR_VALUE), sampled_v, levels_v)
    values = estimate.singular_values
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    error_um = estimate.model().simulate(voltage_v) - steady_um
    rows = [
        Row(SECTION, "sampled points", 3661, sampled_v.size, "1"),
        Row(SECTION, "rank of A^T A", 1830, rank, "1"),
        Row(SECTION, "condition number of A^T A", 1.92e7, values[0] / values[rank - 1], "1"),
        Row(SECTION, "singular values kept, those above 1.2", None, estimate.rank, "1"),
        Row(SECTION, "e_h (3.22) over all samples", 3.0,
            float(100.0 * np.linalg.norm(error_um) / np.linalg.norm(steady_um)), "%",
            "creep within the harmonics remains", below=True),
        Row(SECTION, "drift of the stage in 100 s", float(DRIFT(100.0) - DRIFT(0.0)),
            float(drift(100.0) - drift(0.0)), "um",
            "the simulated stage's creep; the thesis' stage drifts differently"),
        Row(SECTION, "remaining drift at the samples at rest, RMS", None,
            float(np.std(steady_um[starts])), "um"),
        Row(SECTION, "quadratic term of the thesis' drift, added and found", 1.21e-4,
            float(known.convert().coef[2]), "um/s^2"),
        Row(SECTION, "linear term of the thesis' drift, added and found", 0.0127,
            float(known.convert().coef[1]), "um/s"),
    ]
    return Study(rows, {
        "3.5": _draw_drift(time_s[starts], displacement_um[starts], drift, steady_um[starts]),
        "3.6": draw_estimate(estimate, LEAST_SINGULAR_VALUE),
    })


def _draw_drift(time_s, displacement_um, drift, steady_um):
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2)
    displacement_um = displacement_um - displacement_um[0]
    left.plot(time_s, displacement_um, color=GREY, marker="o", markersize=4, linestyle="none",
              label="at rest")
    offset_um = np.mean(displacement_um - drift(time_s))
    left.plot(time_s, offset_um + drift(time_s), color=BLUE, label="polynomial")
    left.legend()
    label(left, "time (s)", "drift (um)")
    right.plot(time_s, 1e3 * steady_um, color=VERMILION, marker=".", linestyle="none")
    label(right, "time (s)", "remaining drift (nm)")
    return figure
