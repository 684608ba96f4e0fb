# SPDX-License-Identifier: BSD-3-Clause
"""The same steps in Python with arrays of two axes."""

import control
import numpy as np
import pytest
from scipy.signal import lfilter

import piezo_offline
from piezo_identification.axes import diagnosed_errors
from piezo_identification.axes.axis_effects import AxisEffect
from piezo_models import IdentifiedAxes
from piezo_recorder import RecordingError

ROWS = 500
GAIN = np.array([[0.2, 0.004], [-0.003, 0.15]])


def columns(seed):
    """Return columns of two lagged axes with static coupling, from rest."""
    rng = np.random.default_rng(seed)
    drive = rng.normal(size=(ROWS, 2)) * (np.arange(ROWS)[:, None] > 20)
    moved = lfilter([0.0, 0.4], [1.0, -0.6], drive @ GAIN.T, axis=0)
    measured = moved + 1e-3 * rng.normal(size=moved.shape)
    return {"time_s": 1e-3 * np.arange(ROWS), "x_voltage_v": drive[:, 0],
            "y_voltage_v": drive[:, 1], "x_displacement_um": measured[:, 0],
            "y_displacement_um": measured[:, 1]}


@pytest.fixture(scope="module")
def identified():
    return piezo_offline.identify(dynamics=columns(1), validation=columns(2), modes=1)


def test_arrays_of_two_axes_give_a_model_of_both(identified):
    assert isinstance(identified, IdentifiedAxes)
    np.testing.assert_allclose(identified.model.response(0.0)[0].real, GAIN, atol=2e-3)
    assert all(error["e_y_percent"] < 3.0 for error in identified.errors.values())


ONE_AXIS = {"time_s": [0.0], "voltage_v": [0.0], "displacement_um": [0.0]}


@pytest.mark.parametrize("given", [
    {"dynamics": [columns(1), ONE_AXIS]}, {"dynamics": columns(1), "creep": ONE_AXIS},
    {"dynamics": ONE_AXIS, "validation": columns(1)}])
def test_data_of_one_axis_beside_those_of_two_are_refused(given):
    with pytest.raises(RecordingError, match="some data are of one axis and others of several"):
        piezo_offline.identify(**given)


def test_a_saved_model_simulates_alike(identified, tmp_path):
    path = tmp_path / "model.json"
    piezo_offline.save_model(path, identified)
    assert isinstance(piezo_offline.load_model(path), IdentifiedAxes)
    unseen = columns(3)
    errors = piezo_offline.simulate(path, unseen).e_y_percent()
    assert errors == pytest.approx(piezo_offline.simulate(identified, unseen).e_y_percent())


def test_several_recordings_are_refused_where_one_is_simulated(identified):
    with pytest.raises(ValueError, match="hold 2 recordings"):
        piezo_offline.simulate(identified, [columns(3), columns(4)])


def test_an_axis_that_moves_more_is_named(identified, tmp_path, monkeypatch):
    # Which of all effects is named is asked in the tests of the diagnosis.
    monkeypatch.setattr(diagnosed_errors, "all_effects", lambda axes: [
        AxisEffect("gain", axis) for axis in axes])
    more = columns(3)
    more["x_displacement_um"] *= 1.05
    verdict = piezo_offline.diagnose(identified, more)
    assert (verdict.verdict, verdict.effects[0]["name"]) == ("explained", "gain")
    assert verdict.effects[0]["parameters"]["axis"] == "x"
    piezo_offline.save_model(tmp_path / "extended.json", verdict.extended)
    again = piezo_offline.diagnose(tmp_path / "extended.json", more)
    assert (again.verdict, again.effects) == ("none", [])
    with pytest.raises(ValueError, match="holdout and identified_from are for a model of one axis"):
        piezo_offline.diagnose(identified, more, columns(4))


def test_a_file_of_two_axes_is_not_read_alone(tmp_path):
    path = tmp_path / "both.csv"
    table = columns(1)
    np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", header=",".join(table),
               comments="")
    with pytest.raises(RecordingError, match="hand the file itself to check"):
        piezo_offline.read(path)


def response(seed=1):
    """Return the measured response of the same stage, between held samples."""
    stage = control.ss(0.6 * np.eye(2), np.eye(2), 0.4 * GAIN, np.zeros((2, 2)), 1e-3)
    exact = control.frequency_response(stage, np.linspace(20.0, 3000.0, 200))
    noise = np.random.default_rng(seed).normal(size=(2, *exact.frdata.shape))
    return control.frd(exact.frdata + 1e-4 * (noise[0] + 1j * noise[1]), exact.omega, dt=1e-3)


def test_a_response_of_python_control_gives_a_model_of_both():
    identified = piezo_offline.identify(dynamics=response(), validation=columns(2), modes=1)
    np.testing.assert_allclose(identified.model.response(0.0)[0].real, GAIN, atol=2e-3)
    assert all(error["e_y_percent"] < 3.0 for error in identified.errors.values())


def test_a_response_beside_recordings_or_as_one_is_refused(identified):
    for refuse in (lambda: piezo_offline.identify(dynamics=[response(), columns(1)]),
                   lambda: piezo_offline.identify(dynamics=columns(1), creep=response()),
                   lambda: piezo_offline.simulate(identified, response())):
        with pytest.raises(RecordingError, match="give it alone, as the dynamics of identify"):
            refuse()
