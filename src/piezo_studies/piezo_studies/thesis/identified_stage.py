# SPDX-License-Identifier: BSD-3-Clause
"""Section 4.7.1: the simulated stage with the thesis' parameters, identified step by step."""

from functools import cache

import numpy as np

from piezo_common.picture_style import new_figure
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.experiments import catalogue as experiments
from piezo_models.cascade import StageModel
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.laboratory import ROWS_LATE, record_experiment
from piezo_studies.thesis.pictures import draw_plane

SECTION = "4.7.1"
CREEP_POLES_RAD_PER_S = (0.01419, 0.1684, 0.2402, 1.053, 17.57)
DYNAMICS = (
    ("time constant", 0.00049, "s"),
    ("frequency of mode 1", 2846.0, "rad/s"),
    ("frequency of mode 2", 4909.0, "rad/s"),
    ("damping of mode 1", 3901.0 / (2.0 * 2846.0), "1"),
    ("damping of mode 2", 805.0 / (2.0 * 4909.0), "1"),
)


@cache
def identified_stage():
    """Identify the simulated stage over the whole range of the amplifier."""
    slow, quick, harmonics = (
        record_experiment(experiments.named_experiment(name), seed=seed)
        for seed, name in enumerate(("creep", "dynamics", "hysteresis"), start=1)
    )
    dynamics = estimate_dynamics(
        quick, estimate_creep(slow).model, delay=ROWS_LATE).model
    creep = estimate_creep(slow, dynamics).model
    dynamics = estimate_dynamics(quick, creep, delay=ROWS_LATE).model
    return StageModel(estimate_density(harmonics, creep, dynamics).model(), creep, dynamics)


def study():
    """List the identified parameters together with those of the thesis."""
    model = identified_stage()
    creep, dynamics = model.creep, model.dynamics
    poles = np.array(creep.poles_rad_per_s)
    found = (dynamics.time_constant_s, *dynamics.mode_frequencies_rad_per_s,
             *dynamics.damping_ratios)
    rows = [
        Row(SECTION, "creep poles", 5, poles.size, "1", "the number that the criterion chooses"),
        Row(SECTION, "slowest creep pole", CREEP_POLES_RAD_PER_S[0], poles.min(), "rad/s"),
        Row(SECTION, "fastest creep pole", CREEP_POLES_RAD_PER_S[-1], poles.max(), "rad/s"),
        *(Row(SECTION, name, thesis, ours, unit)
          for (name, thesis, unit), ours in zip(DYNAMICS, found, strict=True)),
    ]
    figure = new_figure(3.4)
    hysteresis = model.hysteresis
    draw_plane(figure, figure.subplots(), hysteresis.levels_v,
               1e3 * hysteresis.density_um_per_v2, "density (nm/V²)")
    return Study(rows, {"4.11": figure})
