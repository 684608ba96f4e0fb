# SPDX-License-Identifier: BSD-3-Clause
"""What a file makes of an identification that shows something else than it was given for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import piezo_identification.identification.identify as module
from piezo_identification.estimators.estimate import Estimate, OrderTrial
from piezo_identification.identification.given_data import conditioned_data
from piezo_identification.identification.identify import identify
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S = 0.02


@pytest.fixture
def creep(tmp_path):
    """Four steps at fifty rows a second, of a sensor that counts down."""
    path = tmp_path / "creep.csv"
    path.write_text("creep")
    voltage_v = np.repeat([0.0, 60.0, 20.0, 100.0, 0.0], [40, 100, 100, 100, 100])
    noise_um = 0.003 * np.random.default_rng(1).normal(size=voltage_v.size)
    return Recording(
        str(path), 1.0 / PERIOD_S, np.arange(voltage_v.size),
        np.full(voltage_v.size, PERIOD_S), voltage_v, -0.5 * voltage_v + noise_um,
        np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))


def test_a_sensor_that_counts_down_is_recognised_in_the_dynamics_alone(creep):
    notes = []
    [seen] = conditioned_data({"dynamics": creep}, notes.append, 0.0).values()
    assert sum("its sign is changed" in note for note in notes) == 1
    assert np.corrcoef(seen.voltage_v, seen.displacement_um)[0, 1] > 0.99


def test_a_failure_of_linear_algebra_names_stage_and_recordings(creep, monkeypatch):
    monkeypatch.setattr(module, "estimate_loops", lambda *_: np.linalg.cholesky(-np.eye(2)))
    with pytest.raises(ValueError, match="hysteresis: cannot be computed from .*creep.csv "
                                         ".*: a recording does not show") as raised:
        identify(creep=creep)
    assert not isinstance(raised.value, np.linalg.LinAlgError)


@pytest.mark.parametrize("levels_v, is_line, notes", [
    ([0.0, 100.0, 0.0], False, 1), ([0.0, 100.0, 0.0], True, 0),
    ([0.0, 100.0, 50.0, 80.0], False, 0)])
def test_a_hysteresis_of_a_single_loop_is_named_as_such(creep, levels_v, is_line, notes):
    voltage_v = np.interp(np.linspace(0.0, len(levels_v) - 1.0, creep.voltage_v.size),
                          range(len(levels_v)), levels_v)
    told = []
    module.report_single_loop(
        [replace(creep, voltage_v=voltage_v)], SimpleNamespace(is_line=is_line), told.append)
    assert len(told) == notes
    assert all("creep.csv turns at the ends of its range only" in text for text in told)


@pytest.mark.parametrize("refusals, expected", [
    (["a gain that the loops do not have"] * 2, 1), (["", "a lag as long as the record"], 0)])
def test_dynamics_of_which_no_order_can_be_used_are_implausible(refusals, expected):
    trials = tuple(OrderTrial(str(number), 5, 0.1, float(number), refusal)
                   for number, refusal in enumerate(refusals))
    estimate = Estimate(ElectricVibrationDynamics(), {}, trials[0].order, trials)
    told = []
    module.report_estimates(LinearDynamics(estimates={"dynamics": estimate}),
                            SimpleNamespace(is_line=True, report=lambda: "a line"), told.append)
    implausible = [text for text in told if text.startswith("implausible: every order of the")]
    assert len(implausible) == expected
    assert all("has a gain that the loops do not have, or another fault" in text
               for text in implausible)
