# SPDX-License-Identifier: BSD-3-Clause
"""Shorter identifications and diagnoses, for tests that look at what surrounds them.

Each is a tuple of (owner, name, replacement), for `replaced`.
"""

from functools import partial

from piezo_identification.diagnosis import diagnose
from piezo_identification.diagnosis.comparison import selection
from piezo_identification.diagnosis.experiment_design import propose
from piezo_identification.diagnosis.experiment_design.propose import grid
from piezo_identification.estimators.dynamics import pole_search
from piezo_identification.experiments import several_axes
from piezo_identification.fitting import structure_search
from piezo_identification.identification import one_fit
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_models.effects import known_effects

FEW_POLES = ((pole_search, "MOST_MODES", 4),)
"""The search for the poles of a fast record begins with 4 modes; the stages have two."""

WITHOUT_SEARCH = (
    (one_fit, "searched", lambda problem, best, *_: (best, [])),
    (one_fit, "is_at_noise", lambda *_: True), (structure_search, "is_at_noise", lambda *_: True))
"""No other structure is sought than that of the separate steps."""

GIVEN_DENSITY = ((DensityOptions, "keywords", lambda _: {
    "level_count": 80, "cells_per_level": 1, "smoothing_weight": 1e-13,
    "translation_weight": 1e-12}),)
"""Grid and weights of the density are given; their choice takes most of an identification."""

WITHOUT_CEILING = ((diagnose, "ceiling_of", lambda *_: None),)
"""No learner is trained on the residual of a diagnosis: it takes longer than most diagnoses."""


def comparing(*names):
    """Compare the effects of these names alone."""
    return ((selection, "known_effects", lambda: {
        name: kind for name, kind in known_effects().items() if name in names}),)


FEW_EFFECTS = (*WITHOUT_CEILING, *comparing(
    "amplifier_lag", "delay", "sensor_lag", "vibration_mode", "voltage_clipping"))
"""A diagnosis compares five effects, and trains no learner."""

FEW_WAVEFORMS = (
    (propose, "grid", lambda: [point for point in grid() if point.family.name == "sweep"][-2:]),
    (propose, "FACTORS", ()))
"""The next experiment is one of two sweeps, as they are."""

SHORT_PERIODS = (
    (several_axes, "orthogonal_multisines",
     partial(several_axes.orthogonal_multisines, period_s=0.1)),)
"""The multisines of several axes have lines every 10 Hz."""
