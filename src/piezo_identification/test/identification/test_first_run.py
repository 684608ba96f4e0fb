# SPDX-License-Identifier: BSD-3-Clause
"""Square waves that begin off the loop of their later levels."""

import numpy as np
import pytest

from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.identification.identify import identify
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

PERIOD_S, NOISE_UM, STEP = 0.05, 2e-3, 400
VOLTAGE_V = np.where(np.arange(2400) // STEP % 2, 50.0, 20.0)


@pytest.fixture(scope="module")
def creep():
    stage = StageModel(PreisachModel.line(20.0, 50.0, 0.1),
                       CreepDynamics((0.3,), (0.32,)), ElectricVibrationDynamics())
    moved_um = stage.simulate(VOLTAGE_V, PERIOD_S)
    moved_um[: STEP + 1] -= 0.4
    noise_um = np.random.default_rng(2).normal(scale=NOISE_UM, size=VOLTAGE_V.size)
    return recording_of({"time_s": PERIOD_S * np.arange(VOLTAGE_V.size), "voltage_v": VOLTAGE_V,
                         "displacement_um": moved_um + noise_um})


def test_the_fit_of_the_whole_model_does_not_contain_them(creep):
    notes = []
    identified = identify(creep=creep, note=notes.append)
    assert any("off the loop of the later ones: left out" in note for note in notes)
    (table,) = (note for note in notes if note.startswith("one fit of the whole model"))
    written = next(line for line in table.splitlines() if line.endswith("<- written"))
    assert float(written.split()[-3]) == pytest.approx(NOISE_UM, rel=0.05)
    assert identified.model.creep.poles_rad_per_s == pytest.approx((0.3,), rel=1e-2)
    assert identified.adequacy["creep"]["verdict"] == "adequate"


def test_dynamics_without_loops_are_fitted_from_where_the_loop_is_closed():
    """A line has no first rise, which is higher than the later ones."""
    cells = np.tril(np.full((12, 12), 2e-3))
    stage = StageModel(PreisachModel(0.0, 60.0, cells, 0.0, np.full(12, 0.1)), CreepDynamics(),
                       ElectricVibrationDynamics(1e-4, (4400.0,), (0.02,)))
    voltage_v = np.where(np.arange(12_000) // 300 % 2, 50.0, 10.0)
    noise_um = np.random.default_rng(1).normal(scale=NOISE_UM, size=voltage_v.size)
    recording = recording_of({"time_s": 1e-4 * np.arange(voltage_v.size), "voltage_v": voltage_v,
                              "displacement_um": stage.simulate(voltage_v, 1e-4) + noise_um})
    identified = identify(dynamics=recording, order=ResponseOrder(0, 1, 0))
    assert identified.adequacy["dynamics"]["verdict"] == "adequate"
    dynamics = identified.model.dynamics
    assert dynamics.mode_frequencies_rad_per_s == pytest.approx((4400.0,), rel=1e-5)
    assert dynamics.damping_ratios == pytest.approx((0.02,), rel=1e-3)
