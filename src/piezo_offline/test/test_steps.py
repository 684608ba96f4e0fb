# SPDX-License-Identifier: BSD-3-Clause
"""The steps take paths, arrays, frames and lists alike, and say what they cannot use."""

import warnings

import numpy as np
import pytest

from piezo_identification.identification.notes import Implausible
from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_offline import (
    DataWarning,
    compare,
    design,
    diagnose,
    identify,
    read,
    save_model,
    simulate,
    steps,
)
from piezo_recorder.reading.reader import origin_of
from piezo_recorder.reading.recording import Recording

TIME_S = 0.01 * np.arange(600)
VOLTAGE_V = 50.0 - 50.0 * np.cos(np.pi * TIME_S)
MODEL = StageModel(
    PreisachModel(0.0, 100.0, np.zeros((4, 4)), 1.0, np.full(4, 0.4)), CreepDynamics(),
    ElectricVibrationDynamics())


def arrays(displacement_um):
    return {"time_s": TIME_S, "voltage_v": VOLTAGE_V, "displacement_um": displacement_um}


@pytest.fixture
def measured_um():
    return MODEL.simulate(VOLTAGE_V, 0.01)


def test_prediction_of_arrays_a_frame_and_a_file_is_the_same(measured_um, tmp_path):
    pandas = pytest.importorskip("pandas")
    data = arrays(1.02 * measured_um)
    frame = pandas.DataFrame(data)
    frame.to_csv(tmp_path / "mine.csv", index=False)
    errors = [simulate(MODEL, each).e_y_percent()
              for each in (data, frame, tmp_path / "mine.csv", read(data))]
    assert errors == pytest.approx([100.0 * 0.02 / 1.02] * 4, rel=1e-6)


def test_three_arrays_are_time_voltage_and_displacement(measured_um):
    recording = read(TIME_S, VOLTAGE_V, measured_um)
    np.testing.assert_array_equal(recording.voltage_v, VOLTAGE_V)
    np.testing.assert_array_equal(recording.displacement_um, measured_um)
    with pytest.raises(ValueError, match="columns have different numbers of values"):
        read(TIME_S, VOLTAGE_V, measured_um[:-1])


def test_what_a_first_call_gets_wrong_is_answered_by_how_to_call(measured_um, tmp_path):
    with pytest.raises(ValueError, match=r"read\(time_s, voltage_v, displacement_um\)"):
        read(TIME_S, VOLTAGE_V)
    with pytest.raises(TypeError, match=r'save_model\("model.json", model\)'):
        save_model(IdentifiedModel(MODEL, voltage_range_v=(0.0, 100.0)), tmp_path / "model.json")
    with pytest.raises(TypeError, match="float is no identified model"):
        save_model(tmp_path / "model.json", 3.0)
    with pytest.raises(TypeError, match="float is no model: give a model, or the path"):
        simulate(3.0, measured_um)
    with pytest.raises(ValueError, match="unknown method 'lqr'"):
        design(MODEL, method="lqr")
    with pytest.raises(ValueError, match="unknown feedback 'lqr': use one of h-infinity, pi"):
        design(MODEL, feedback="lqr")
    with pytest.raises(ValueError, match="the model has no dynamics"):
        design(MODEL)
    monitor = {"t [s]": TIME_S, "monitor [V]": 0.05 * VOLTAGE_V, "y [um]": measured_um}
    np.testing.assert_allclose(read(monitor, "voltage=monitor[20V]").voltage_v, VOLTAGE_V)


def test_columns_are_asked_for_as_an_argument(measured_um):
    with pytest.raises(ValueError, match=r'columns=\["time=NAME\[s\]", "voltage=') as refused:
        read({"first": TIME_S, "second": VOLTAGE_V, "third": measured_um})
    assert "--columns" not in str(refused.value)


def test_two_models_are_compared_on_one_recording(measured_um):
    worse = StageModel(MODEL.hysteresis, CreepDynamics((0.5,), (0.6,)), MODEL.dynamics)
    compared = compare(MODEL, worse, arrays(measured_um))
    (_, error_a, *_), (_, error_b, *_) = compared.summary().rows
    assert error_a < 0.01 < error_b
    assert error_b == compared.b.e_y_percent()
    assert [line.get_label() for line in compared.plot().axes[0].lines] == ["model a", "model b"]


def test_simulate_and_diagnose_read_rows_as_those_of_the_identification(monkeypatch):
    """Rows of a logger that reads at the end of the hold, as the one of the model did."""
    voltage_v = np.random.default_rng(3).uniform(0.0, 100.0, 3000)
    measured_um = MODEL.simulate(voltage_v, 1e-3)
    data = {"time_s": 1e-3 * np.arange(2999), "voltage_v": voltage_v[:-1],
            "displacement_um": measured_um[1:]}
    row = {"read_at_samples": 1.0, "delay_s": 0.0, "standard_deviation_s": 0.0}
    model = IdentifiedModel(MODEL, (0.0, 100.0), rows={"hysteresis": row})
    with pytest.warns(DataWarning, match="read 1 sample periods after"):
        prediction = simulate(model, data)
    assert prediction.e_y_percent() < 0.1
    asked = []
    monkeypatch.setattr(steps, "diagnose_recordings", lambda *given: asked.append(given))
    with pytest.warns(DataWarning, match="read 1 sample periods after"):
        diagnose(model, data, data)
    for recording in (*asked[0][1], asked[0][2]):
        assert recording.sample_index[0] == 1


def test_recordings_that_are_said_to_be_of_the_identification_are_read_as_they_were(
        measured_um, monkeypatch):
    asked = []
    monkeypatch.setattr(steps, "diagnose_recordings", lambda *given: asked.append(given))
    fitted, new = read(arrays(measured_um)), arrays(2.0 * measured_um)
    model = IdentifiedModel(
        MODEL, (0.0, 100.0), sample_periods_s={"hysteresis": 0.01},
        recordings=[origin_of(fitted)], rows={"hysteresis": {"read_at_samples": 1.0}})
    diagnose(model, new, identified_from=arrays(measured_um))
    (known,) = asked[0][4].recordings
    np.testing.assert_array_equal(known.displacement_um, measured_um[:-1])
    assert known.sample_index[0] == 1


def test_what_was_assumed_or_is_implausible_is_a_warning(measured_um):
    with pytest.warns(DataWarning, match="'u' has no unit; it is taken for the voltage"):
        read({"time_s": TIME_S, "u": VOLTAGE_V, "y_um": measured_um})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert isinstance(read(arrays(measured_um)), Recording)


def test_what_an_identification_finds_implausible_is_a_warning(monkeypatch, measured_um):
    """By what it is, not by the word with which a sentence begins."""
    said = [Implausible("a range of 1 um over 100 V"), "implausible as it sounds, all is well"]

    def identify_said(note, **given):
        for text in said:
            note(text)

    monkeypatch.setattr(steps, "identify_recordings", identify_said)
    told = []
    with pytest.warns(DataWarning) as warned:
        identify(hysteresis=arrays(measured_um), note=told.append)
    assert told == said
    assert [str(each.message) for each in warned if "range" in str(each.message)] == said[:1]
    assert not any("sounds" in str(each.message) for each in warned)


def test_recording_that_cannot_stand_for_its_experiment_is_named_before_the_fit(measured_um):
    short = {name: values[:3] for name, values in arrays(measured_um).items()}
    with pytest.warns(DataWarning, match="dynamics can hardly stand for the dynamics"), \
            pytest.raises(ValueError):
        identify(dynamics=short)


@pytest.mark.parametrize(("call", "objection"), [
    (lambda data: identify(), "nothing to identify"),
    (lambda data: identify(hysteresis=data, rows_read="middle"), 'give "start" or "end"'),
    (lambda data: identify(hysteresis=data, grid=-3), "grid is -3: give 4 to 300"),
    (lambda data: identify(dynamics=data, modes=-2), "modes is -2: give 0 or more"),
    (lambda data: design(MODEL, sample_rate_hz=-4.0),
     "sample_rate_hz is -4: give a positive number"),
    (lambda data: simulate(MODEL, 3.0), "a float is no recording"),
    (lambda data: diagnose(MODEL, []), "there is no recording to diagnose"),
    (lambda data: design("no_such_model.json"), "no_such_model.json"),
])
def test_what_cannot_be_used_is_refused_in_one_line(call, objection, measured_um):
    with pytest.raises(ValueError, match=objection) as refused:
        call(arrays(measured_um))
    assert "\n" not in str(refused.value)


def test_diagnosis_asks_what_the_model_was_identified_from(measured_um, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(steps, "diagnose_recordings", lambda *given: asked.append(given))
    data, path = arrays(measured_um), tmp_path / "loops.csv"
    np.savetxt(path, np.column_stack(list(data.values())), delimiter=",",
               header=",".join(data), comments="")
    model = identify(hysteresis=path, grid=8)
    diagnose(model, data)
    diagnose(model, path)
    diagnose(model, data, identified_from=[arrays(2.0 * measured_um), arrays(3.0 * measured_um)])
    diagnose(model.model, data)
    assert [len(given[4].recordings) for given in asked] == [1, 0, 3, 0]


@pytest.mark.parametrize("grid", [
    12, *(pytest.param(grid, marks=pytest.mark.long) for grid in (16, 30))])
def test_exact_data_give_the_line_that_they_are(measured_um, grid):
    model = identify(hysteresis=arrays(measured_um), grid=grid).model
    np.testing.assert_allclose(
        model.simulate(VOLTAGE_V, 0.01), measured_um, atol=1e-6 * np.ptp(measured_um))
