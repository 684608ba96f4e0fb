# SPDX-License-Identifier: BSD-3-Clause
"""Section 4.6.2: the density of a known plant from few samples, with creep and dynamics removed."""

import numpy as np

from piezo_common.picture_style import GREY, MODELLED, label, new_figure
from piezo_identification.estimators.hysteresis.density_fit import hysteresis_output_um
from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_studies.baselines.relay_regression import accumulate, excitation_rank
from piezo_studies.baselines.sampling_rules import sample_by_voltage
from piezo_studies.baselines.svd_estimate import density_by_svd, truncated_svd
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.known_plant import HIGHEST_V, NOISE_UM, density_um_per_v2, known_plant
from piezo_studies.thesis.laboratory import record_model
from piezo_studies.thesis.pictures import draw_plane

LEVELS = 10
HARMONIC_PERIOD_S = 1.0
SAMPLE_PERIOD_S = 1e-3
DRAWS = 9
"""Number of draws of the noise, of which the median error is reported."""

SECTION = "4.6.2"


def study():
    """Compute the density errors by least squares and by the smoothed fit."""
    plant = known_plant()
    levels_v = np.linspace(0.0, HIGHEST_V, LEVELS + 1)
    duration = round(LEVELS * HARMONIC_PERIOD_S / SAMPLE_PERIOD_S) + 1
    time_s = np.arange(duration, dtype=float) * SAMPLE_PERIOD_S
    voltage_v = stair_harmonics(time_s, stair_amplitudes(LEVELS, HIGHEST_V), HARMONIC_PERIOD_S)
    records = [
        record_model("harmonics", plant, voltage_v, SAMPLE_PERIOD_S, NOISE_UM, seed)
        for seed in range(DRAWS)
    ]
    outputs_um = [hysteresis_output_um(r, plant.creep, plant.dynamics) for r in records]
    samples = sample_by_voltage(voltage_v, levels_v)
    falling = np.flatnonzero(np.diff(voltage_v[samples], append=0.0) < 0.0)
    descending = np.union1d(samples[falling], samples[voltage_v[samples] < 1e-9])
    true = density_um_per_v2(levels_v)

    def least_squares(chosen):
        def estimate(output_um):
            equations = accumulate(voltage_v, output_um, levels_v, chosen)
            return density_by_svd(truncated_svd(equations, 1e-9), voltage_v, levels_v)

        return estimate

    def smoothed(chosen):
        return lambda output_um: smoothed_density(voltage_v, output_um, levels_v, chosen)

    def error(method):
        """Return the median error over the draws of the noise in percent."""
        return float(np.median([
            100.0 * np.linalg.norm(method(output_um).density_um_per_v2 - true)
            / np.linalg.norm(true)
            for output_um in outputs_um
        ]))

    rows = [
        Row(SECTION, "sampled points", 66, descending.size, "1",
            "those on the way down; with both ways, rule (4.10) gives the next row"),
        Row(SECTION, "sampled points, both ways", None, samples.size, "1"),
        Row(SECTION, "rank of A^T A", 55,
            excitation_rank(voltage_v[samples], levels_v), "1"),
        Row(SECTION, "density error, least squares, 66 points", 2.0,
            error(least_squares(descending)), "%",
            "does not come out: each density is a difference of four noisy outputs", below=True),
        Row(SECTION, "density error, least squares, 111 points", 2.0,
            error(least_squares(samples)), "%", below=True),
        Row(SECTION, "density error, smoothed non-negative, 111 points", 2.0,
            error(smoothed(samples)), "%", below=True),
        Row(SECTION, "density error, smoothed non-negative, all samples", 2.0,
            error(smoothed(None)), "%", "the same recording every millisecond", below=True),
    ]
    return Study(rows, {"4.9": _draw(records[0], outputs_um[0], smoothed(None)(outputs_um[0]))})


def _draw(record, output_um, estimate):
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2)
    left.plot(record.voltage_v, record.displacement_um, color=GREY, linewidth=0.8,
              label="measured")
    left.plot(record.voltage_v, output_um, **{**MODELLED, "linewidth": 0.8,
                                              "label": "creep removed"})
    left.legend()
    label(left, "voltage (V)", "displacement (um)")
    draw_plane(figure, right, estimate.levels_v, estimate.density_um_per_v2, "density (um/V²)")
    return figure
