# SPDX-License-Identifier: BSD-3-Clause
"""The law that the hysteresis of every plant keeps, whatever its form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_sim.effects.generalised_plays import GeneralisedPlays, PlaysRunner
from piezo_sim.plant.continuous_preisach import HysteresisRunner, PreisachHysteresis
from piezo_sim.plant.plant_file import read_plant

SLOWLY_S = 1.0  # against microseconds of viscosity


def effect_of(plant, kind):
    return next(effect for effect in read_plant(plant).stage if isinstance(effect, kind))


PREISACH, PLAYS = effect_of("default", PreisachHysteresis), effect_of("beam", GeneralisedPlays)
RUNNERS = {"default": lambda: HysteresisRunner(PREISACH),
           "beam": lambda: PlaysRunner(PLAYS, SLOWLY_S)}

voltages = st.floats(-20.0, 120.0)


@pytest.mark.parametrize("plant", RUNNERS)
@settings(deadline=None)  # the first example may compile
@given(
    history_v=st.lists(voltages, min_size=1, max_size=10),
    corners_v=st.tuples(voltages, voltages, voltages, voltages).map(sorted),
    future_v=st.lists(voltages, min_size=1, max_size=10),
)
def test_a_larger_excursion_wipes_out_a_closed_loop(plant, history_v, corners_v, future_v):
    low_v, inner_low_v, inner_high_v, high_v = corners_v
    after_um = []
    for loop_v in ([inner_high_v, inner_low_v], []):
        samples = np.array([*history_v, low_v, *loop_v, high_v, *future_v])
        RUNNERS[plant]().apply(samples)
        after_um.append(samples[-len(future_v) - 1:])
    assert after_um[0] == pytest.approx(after_um[1], abs=1e-9)
