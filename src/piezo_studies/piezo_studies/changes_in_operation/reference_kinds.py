# SPDX-License-Identifier: BSD-3-Clause
"""Twenty kinds of references within the travel of the simulated stages, and their feedforward."""

from dataclasses import replace
from functools import cache

import numpy as np

from piezo_controller.feedforward.periodic import FeedforwardPlan, plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference, trajectory
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models.cascade import StageModel

CLOCK = StageClock(sample_rate_hz=4000.0, samples_per_tick=4)
"""Clock at a tenth of the usual rate, so that an hour is simulated in seconds."""

RUN_S = 60.0
"""Duration of a run with one reference, including its approach (s)."""

PERIOD_S, FADE_S = 20.0, 0.5
"""Period of a random reference, and time in which it is faded in and out (s)."""

DRAWS = 5
"""Number of random references of a kind."""

KINDS: dict[str, Reference] = {
    "sine 0.5 Hz, 80 um": Reference("harmonic", (0.5,), (80.0,), centre_um=57.0),
    "sine 1 Hz, 20 um": Reference("harmonic", (1.0,), (20.0,), centre_um=30.0),
    "sine 7 Hz, 40 um": Reference("harmonic", (6.25,), (40.0,), centre_um=60.0),
    "sine 10 Hz, 60 um": Reference("harmonic", (10.0,), (60.0,), centre_um=57.0),
    "sine 50 Hz, 10 um": Reference("harmonic", (50.0,), (10.0,), centre_um=80.0),
    "sine 100 Hz, 20 um": Reference("harmonic", (100.0,), (20.0,), centre_um=50.0),
    "sine 200 Hz, 4 um": Reference("harmonic", (200.0,), (4.0,), centre_um=40.0),
    "sine 400 Hz, 2 um": Reference("harmonic", (400.0,), (2.0,), centre_um=57.0),
    "10 and 170 Hz": Reference("multi_frequency", (10.0, 170.0), (40.0, 4.0), (0.0, 1.0), 57.0),
    "50, 400 and 750 Hz": Reference(
        "multi_frequency", (50.0, 400.0, 750.0), (20.0, 8.0, 4.0), centre_um=57.0),
    "1, 3 and 9 Hz": Reference("multi_frequency", (1.0, 3.0, 9.0), (30.0, 15.0, 8.0),
                               centre_um=50.0),
    "triangle 0.1 Hz, 60 um": Reference("triangle", (0.1,), (60.0,), centre_um=57.0),
    "triangle 1 Hz, 50 um": Reference("triangle", (1.0,), (50.0,), centre_um=57.0),
    "triangle 8 Hz, 30 um": Reference("triangle", (8.0,), (30.0,), centre_um=70.0),
    "triangle 25 Hz, 5 um": Reference("triangle", (25.0,), (5.0,), centre_um=35.0),
    "raster 5 Hz, fast axis": Reference("raster", (5.0,), (40.0,), centre_um=57.0, lines=64),
    "raster 10 Hz, slow axis": Reference(
        "raster", (10.0,), (20.0,), centre_um=45.0, axis="slow", lines=64),
    "random to 5 Hz": Reference("random", (0.0, 5.0), (60.0,), centre_um=57.0),
    "random to 40 Hz": Reference("random", (0.0, 40.0), (40.0,), centre_um=57.0),
    "random 100 to 300 Hz": Reference("random", (100.0, 300.0), (10.0,), centre_um=57.0),
}


@cache
def plan_of(kind: str, model: StageModel, draw: int) -> FeedforwardPlan:
    """Plan a run of a kind of reference; only random references depend on the number `draw`."""
    reference = KINDS[kind]
    if reference.kind == "random":
        samples = round(PERIOD_S * CLOCK.sample_rate_hz)
        period_um = trajectory(
            replace(reference, seed=draw % DRAWS), CLOCK.sample_rate_hz).sample(0, samples)
        rise = minimum_jerk(round(FADE_S * CLOCK.sample_rate_hz))
        fade = np.concatenate([rise, np.ones(samples - 2 * rise.size), rise[::-1]])
        period_um = reference.centre_um + fade * (period_um - reference.centre_um)
    else:
        period_um = sample_reference(reference, CLOCK.sample_rate_hz)
    return plan_feedforward(period_um, model, stage=CLOCK, duration_s=RUN_S)
