# SPDX-License-Identifier: BSD-3-Clause
"""Shorter identifications and diagnoses, for tests that look at what surrounds them.

Each is a tuple of (owner, name, what stands there instead).
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
"""Modes with which the search for the poles of a fast record begins; the stages have two."""

WITHOUT_SEARCH = (
    (one_fit, "searched", lambda problem, best, *_: (best, [])),
    (one_fit, "is_at_noise", lambda *_: True), (structure_search, "is_at_noise", lambda *_: True))
"""Of other structures than that of the separate steps."""

GIVEN_DENSITY = ((DensityOptions, "keywords", lambda _: {
    "level_count": 80, "cells_per_level": 1, "smoothing_weight": 1e-13,
    "translation_weight": 1e-12}),)
"""Its grid and weights, whose choice takes most of an identification."""

WITHOUT_CEILING = ((diagnose, "ceiling_of", lambda *_: None),)
"""Train no learner on what a diagnosis leaves: it takes longer than most diagnoses."""


def comparing(*names):
    """Compare the effects of these names alone."""
    return ((selection, "known_effects", lambda: {
        name: kind for name, kind in known_effects().items() if name in names}),)


FEW_EFFECTS = (*WITHOUT_CEILING, *comparing(
    "amplifier_lag", "delay", "sensor_lag", "vibration_mode", "voltage_clipping"))
"""That a diagnosis compares, and no learner of what it leaves."""

FEW_WAVEFORMS = (
    (propose, "grid", lambda: [point for point in grid() if point.family.name == "sweep"][-2:]),
    (propose, "FACTORS", ()))
"""Among which the next experiment is chosen: two sweeps, as they are."""

SHORT_PERIODS = (
    (several_axes, "orthogonal_multisines",
     partial(several_axes.orthogonal_multisines, period_s=0.1)),)
"""Of the multisines of several axes, with lines every 10 Hz."""
