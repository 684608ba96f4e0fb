# SPDX-License-Identifier: BSD-3-Clause
"""Linear effects are compared by what they explain of a frequency response."""

import json
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from piezo_common.budget import Budget
from piezo_identification.commands.diagnose_command import main
from piezo_identification.diagnosis.response import response_diagnosis
from piezo_identification.diagnosis.response.response_diagnosis import diagnose_response
from piezo_identification.diagnosis.response.response_results import response_sentence
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import load_model, save_model

LINE = PreisachModel(-10.0, 10.0, np.zeros((4, 4)), 0.0, np.full(4, 0.5))
MODEL = StageModel(LINE, CreepDynamics(), ElectricVibrationDynamics(3e-4, (2300.0,), (0.02,)))
FREQUENCY_HZ = np.geomspace(1.0, 1000.0, 90)


def measured(extra, noise=2e-4):
    """Return the model's response in another unit times what it does not know."""
    random = np.random.default_rng(7)
    gain = 0.6 * MODEL.small_signal_response(FREQUENCY_HZ) * extra
    return FrequencyResponse("made up", FREQUENCY_HZ, gain + noise * (
        random.normal(size=gain.size) + 1j * random.normal(size=gain.size)))


def test_a_response_that_the_model_explains_needs_nothing():
    diagnosis = diagnose_response(MODEL, measured(1.0))
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.model is MODEL


def test_where_only_other_dynamics_leave_noise_the_model_has_them():
    moved = replace(MODEL, dynamics=replace(MODEL.dynamics, mode_frequencies_rad_per_s=(2323.0,)))
    ratio = moved.small_signal_response(FREQUENCY_HZ) / MODEL.small_signal_response(FREQUENCY_HZ)
    diagnosis = diagnose_response(MODEL, measured(ratio))
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.model.dynamics.mode_frequencies_rad_per_s == pytest.approx((2323.0,), rel=1e-4)
    assert diagnosis.after["rms_um"] < 3.0 * diagnosis.noise_floor_um < diagnosis.before["rms_um"]
    assert "slightly other dynamics" in response_sentence(diagnosis)


def test_a_diagnosis_whose_time_is_over_says_what_it_has_not_tried():
    steps = []
    diagnosis = diagnose_response(
        MODEL, measured(np.exp(-2j * np.pi * FREQUENCY_HZ * 1e-5), noise=2e-6),
        lambda step, fraction: steps.append(step), Budget(1.0, count().__next__))
    assert steps == ["the model's dynamics", "effect 1"]
    assert (diagnosis.verdict, diagnosis.effects) == ("unexplained", [])
    assert diagnosis.not_tried == (
        "the time of 1 s does not suffice; not tried: further linear effects")
    assert diagnosis.document()["interrupted"]


def test_less_than_a_percent_of_the_gain_is_named_where_it_is_more_than_noise():
    diagnosis = diagnose_response(MODEL, measured(
        np.exp(-2j * np.pi * FREQUENCY_HZ * 1e-5), noise=2e-6))
    (found,) = diagnosis.effects
    assert (diagnosis.verdict, found["name"]) == ("explained", "delay")
    assert "stand_in" not in found


def test_a_rise_towards_low_frequencies_is_creep():
    # Another form than the candidate: poles and zeros that are not a decade apart.
    creep = CreepDynamics((5.0, 60.0), (6.0, 66.0)).response(FREQUENCY_HZ)
    diagnosis = diagnose_response(MODEL, measured(creep))
    assert diagnosis.effects[0]["name"] == "creep"
    # The other form leaves several times the noise, which is not explained.
    assert diagnosis.verdict == "unexplained"
    assert "times the noise" in diagnosis.left
    assert diagnosis.after["e_y_percent"] < 0.4 * diagnosis.before["e_y_percent"]


def test_a_further_resonance_is_a_vibration_mode():
    extra = StageModel(LINE, CreepDynamics(), MODEL.dynamics, effects=(
        VibrationMode(4400.0, 0.03, 0.3),)).response(FREQUENCY_HZ) / MODEL.response(FREQUENCY_HZ)
    diagnosis = diagnose_response(MODEL, measured(extra))
    assert diagnosis.effects[0]["name"] == "vibration_mode"
    assert diagnosis.effects[0]["parameters"]["frequency_rad_per_s"] == pytest.approx(
        4400.0, rel=0.01)
    assert diagnosis.after["e_y_percent"] < 0.1 * diagnosis.before["e_y_percent"]


def test_a_mode_and_a_delay_are_found_together():
    extended = replace(MODEL, effects=(VibrationMode(4400.0, 0.03, 0.3), Delay(1e-4)))
    ratio = extended.small_signal_response(FREQUENCY_HZ) / MODEL.small_signal_response(FREQUENCY_HZ)
    diagnosis = diagnose_response(MODEL, measured(ratio))
    found = {entry["name"]: entry for entry in diagnosis.effects}
    assert diagnosis.verdict == "explained"
    assert set(found) == {"vibration_mode", "delay"}
    late = found["delay"]
    deviation_s = late["standard_deviations"]["delay_s"]
    assert 0.0 < deviation_s < 1e-6
    assert late["parameters"]["delay_s"] == pytest.approx(1e-4, abs=5.0 * deviation_s)


def test_no_mode_beyond_the_measured_band_is_proposed():
    further = VibrationMode(9000.0, 0.03, 0.3)
    extra = replace(MODEL, effects=(further,)).response(FREQUENCY_HZ) / MODEL.response(FREQUENCY_HZ)
    for entry in diagnose_response(MODEL, measured(extra)).effects:
        if entry["name"] == "vibration_mode":
            assert entry["parameters"]["frequency_rad_per_s"] <= 2.0 * np.pi * FREQUENCY_HZ[-1]


def test_an_effect_that_raises_the_error_of_the_gain_is_not_named(monkeypatch):
    """The evidence weighs every frequency by its noise; the reported errors do not."""
    monkeypatch.setattr(response_diagnosis, "fit_each",
                        lambda problem, *more: [problem.fit((Delay(1e-4),), 0)])
    monkeypatch.setattr(response_diagnosis, "is_better", lambda fit, other: True)
    ripple = 1.0 + 0.2 * np.sin(12.0 * np.log(FREQUENCY_HZ))
    diagnosis = diagnose_response(MODEL, measured(ripple))
    assert (diagnosis.effects, diagnosis.model) == ([], MODEL)
    assert "would rise from" in diagnosis.not_decidable["delay"]


def test_what_no_candidate_explains_is_described_and_not_named():
    ripple = 1.0 + 0.2 * np.sin(12.0 * np.log(FREQUENCY_HZ))
    diagnosis = diagnose_response(MODEL, measured(ripple))
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.effects == []
    assert "times the noise" in diagnosis.left


@pytest.mark.usefixtures("without_pictures")
def test_the_command_writes_verdict_model_and_report(tmp_path, capsys, picture_faults):
    save_model(tmp_path / "model.json", IdentifiedModel(MODEL, (-10.0, 10.0)))
    response = measured(np.exp(-2j * np.pi * FREQUENCY_HZ * 4e-4))
    data = tmp_path / "response.csv"
    np.savetxt(data, np.column_stack([FREQUENCY_HZ, response.gain.real, response.gain.imag]),
               delimiter=",", header="frequency_hz,gain_re,gain_im", comments="")
    arguments = ["--model", tmp_path / "model.json", "--data", data, "--output", tmp_path / "out"]
    assert picture_faults(main, [str(argument) for argument in arguments]) == []
    assert "The model lacks delay" in capsys.readouterr().out
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert verdict["effects"][0]["parameters"]["delay_s"] == pytest.approx(4e-4, rel=0.02)
    assert verdict["after"]["e_y_percent"] < 0.1 * verdict["before"]["e_y_percent"]
    extended = load_model(tmp_path / "out" / "extended_model.json").model
    assert extended.effects[0].name == "delay"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "data:image/webp;base64," in page and "delay" in page


def test_a_response_with_few_frequencies_or_beside_another_file_is_refused(tmp_path, capsys):
    short = FrequencyResponse("short", FREQUENCY_HZ[:20], np.ones(20, dtype=complex))
    with pytest.raises(ValueError, match="too few to hold some out"):
        diagnose_response(MODEL, short)
    data = tmp_path / "response.csv"
    data.write_text("frequency_hz,gain_re,gain_im\n1,1,0\n")
    assert main(["--model", str(data), "--data", str(data), str(data),
                 "--output", str(tmp_path)]) == 2
    assert "give it alone" in capsys.readouterr().err


@pytest.mark.parametrize("roundness", [0.0, 0.1, 0.25, 0.5])
def test_a_lag_of_the_sensor_is_in_the_small_signal_response(roundness):
    lagging = replace(MODEL, effects=(SensorLag(1e-3, roundness),))
    ratio = lagging.small_signal_response(FREQUENCY_HZ) / MODEL.small_signal_response(FREQUENCY_HZ)
    slow = 2e-3j * np.pi * FREQUENCY_HZ
    np.testing.assert_allclose(ratio, 1.0 / (1.0 + slow + roundness * slow**2))


def lag_response(time_constant_s, roundness, frequency_hz=FREQUENCY_HZ):
    slow = 2j * np.pi * frequency_hz * time_constant_s
    return 1.0 / (1.0 + slow + roundness * slow**2)


@pytest.mark.parametrize("roundness", [
    0.25, *(pytest.param(roundness, marks=pytest.mark.long) for roundness in (0.0, 0.4))])
def test_the_shape_of_a_lag_is_found(roundness):
    diagnosis = diagnose_response(MODEL, measured(lag_response(8e-4, roundness)))
    found = diagnosis.effects[0]
    assert found["name"] == "sensor_lag"
    assert found["parameters"]["time_constant_s"] == pytest.approx(8e-4, rel=0.02)
    assert found["parameters"]["roundness"] == pytest.approx(roundness, abs=0.02)


def test_a_lag_far_below_its_corner_is_named_as_a_delay():
    """There a lag of any shape is one phase."""
    frequency_hz = np.geomspace(0.1, 3.0, 90)
    random = np.random.default_rng(7)
    gain = MODEL.small_signal_response(frequency_hz) * lag_response(1e-3, 0.25, frequency_hz)
    noise = 1e-4 * (random.normal(size=90) + 1j * random.normal(size=90))
    diagnosis = diagnose_response(MODEL, FrequencyResponse("slow", frequency_hz, gain + noise))
    (found,) = diagnosis.effects
    assert found["name"] == "delay"
    assert found["parameters"]["delay_s"] == pytest.approx(1e-3, rel=0.1)
    assert diagnosis.confounded_with == {"sensor_lag": "delay"}

