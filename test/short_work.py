# SPDX-License-Identifier: BSD-3-Clause
"""Work without what takes longer than what tests look at: pictures and long searches."""

import os
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from undrawn import save_point

from piezo_common import report_page, side_by_side
from piezo_controller.feedback import loop_measures
from piezo_controller.feedback.synthesis import dk_iteration
from piezo_identification.diagnosis import diagnose
from piezo_identification.diagnosis.comparison import selection
from piezo_identification.estimators.dynamics import pole_search
from piezo_identification.fitting import structure_search
from piezo_identification.identification import one_fit
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_models.effects import known_effects

UNDRAWN = ((Figure, "savefig", save_point), (report_page, "interactive_item", lambda *_: None),
           (side_by_side, "cores", lambda: 1))
FEW_SCALINGS = (
    (dk_iteration, "tick_frequencies", partial(dk_iteration.tick_frequencies, count=20)),
    (dk_iteration, "SEARCHED", 1), (dk_iteration, "ITERATIONS", 2),
    (loop_measures, "_frequencies", lambda tick_s: np.geomspace(0.1, 0.5 / tick_s, 1000)))
"""Of a design of a feedback, whose structured singular value has a third of the frequencies, and
whose loop is measured at an eighth of them."""
FEW_POLES = ((pole_search, "MOST_MODES", 4),)
"""Modes with which the search for the poles of a fast record begins; the stage has two."""

WITHOUT_SEARCH = (
    (one_fit, "searched", lambda problem, best, *_: (best, [])),
    (one_fit, "is_at_noise", lambda *_: True), (structure_search, "is_at_noise", lambda *_: True))
"""Of other structures than that of the separate steps."""
GIVEN_DENSITY = ((DensityOptions, "keywords", lambda _: {
    "level_count": 80, "cells_per_level": 1, "smoothing_weight": 1e-13,
    "translation_weight": 1e-12}),)
"""Its grid and weights, whose choice takes most of an identification."""
FEW_EFFECTS = (
    (selection, "known_effects", lambda: {
        kind.name: kind for kind in known_effects().values()
        if kind.name in (
            "amplifier_lag", "delay", "sensor_lag", "vibration_mode", "voltage_clipping")}),
    (diagnose, "ceiling_of", lambda *_: None))
"""That a diagnosis compares, and no learner of what it leaves."""


def work_shortly() -> None:
    """Let this process draw nothing, use one core, and search at length only by ``make long``."""
    short = () if os.environ.get("LONG_TESTS") else (
        *FEW_SCALINGS, *FEW_POLES, *WITHOUT_SEARCH, *GIVEN_DENSITY, *FEW_EFFECTS)
    for owner, name, instead in (*UNDRAWN, *short):
        assert hasattr(owner, name), f"{owner} has no {name} any more"
        setattr(owner, name, instead)
