# SPDX-License-Identifier: BSD-3-Clause
"""What no piezo stage does is said, and what one may do is not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.adequacy.model_plausibility import implausible_data, implausible_model
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

SINE_V = 50.0 - 50.0 * np.cos(np.arange(4000) * 0.01)
SQUARE_V = np.repeat(np.tile([20.0, 80.0], 10), 200)


def model(range_um=30.0, range_v=100.0, **dynamics):
    hysteresis = PreisachModel(0.0, range_v, np.zeros((1, 1)), 0.0,
                               np.array([range_um / range_v]))
    return StageModel(hysteresis, CreepDynamics(),
                      ElectricVibrationDynamics(**{"time_constant_s": 5e-4} | dynamics))


@pytest.mark.parametrize("voltage_v", [SINE_V, SQUARE_V], ids=["sine", "square"])
@pytest.mark.parametrize("end", [1, -1], ids=["top", "bottom"])
def test_a_sensor_that_clips_is_told(independent_stage, recorded, voltage_v, end):
    displacement_um = independent_stage().displacement_um(voltage_v, 1e-3)
    noisy_um = displacement_um + 0.01 * np.random.default_rng(1).normal(size=voltage_v.size)
    limit_um = np.quantile(noisy_um, 0.5 + 0.2 * end)
    clipped_um = end * np.minimum(end * noisy_um, end * limit_um)
    (text,) = implausible_data({"hysteresis": recorded("clip", voltage_v, clipped_um, 1e-3)})
    assert text.startswith("clip: the displacement stays at its ")
    assert f"value, {limit_um:.6g} um, in " in text


def test_a_sensor_that_clips_at_a_single_held_level_is_told(recorded):
    noisy_um = np.repeat([10.0, 70.0], 500) + 0.01 * np.random.default_rng(1).normal(size=1000)
    (text,) = implausible_data({"creep": recorded(
        "step", np.repeat([20.0, 80.0], 500), np.minimum(noisy_um, 60.0), 0.02)})
    assert "value, 60 um, in 50 % of the samples" in text


def test_a_sensor_that_clips_a_short_overshoot_is_told(recorded):
    time_s = np.tile(np.arange(1000) * 1e-4, 4)
    ringing_um = 60.0 - 40.0 * np.exp(-50.0 * time_s) * np.cos(600.0 * time_s)
    noisy_um = ringing_um + 0.01 * np.random.default_rng(1).normal(size=time_s.size)
    voltage_v = np.repeat(np.tile([20.0, 80.0], 2), 1000)
    displacement_um = np.where(voltage_v < 50.0, 120.0 - noisy_um, noisy_um)
    for clipped_um in (np.minimum(displacement_um, np.sort(displacement_um)[-6]), displacement_um):
        said = implausible_data({"dynamics": recorded("rings", voltage_v, clipped_um, 1e-4)})
        assert ("is clipped" in "".join(said)) == (clipped_um is not displacement_um)


@pytest.mark.parametrize("quantum_um", [0.0, 0.02, 1.0])
@pytest.mark.parametrize("noise_um", [0.0, 0.01])
@pytest.mark.parametrize("voltage_v", [SINE_V, SQUARE_V], ids=["sine", "square"])
def test_a_good_sensor_is_not_said_to_clip(
        independent_stage, recorded, voltage_v, noise_um, quantum_um):
    displacement_um = independent_stage().displacement_um(voltage_v, 1e-3)
    displacement_um = displacement_um + noise_um * np.random.default_rng(1).normal(
        size=voltage_v.size)
    if quantum_um:
        displacement_um = quantum_um * np.round(displacement_um / quantum_um)
    assert implausible_data({"creep": recorded("good", voltage_v, displacement_um, 1e-3)}) == []


def test_dynamics_that_are_sampled_too_slowly_are_told(recorded):
    recording = recorded("slow", SQUARE_V, SQUARE_V + np.arange(SQUARE_V.size) * 1e-3, 0.01)
    said = replace(recording, displacement_um=0.0 * SQUARE_V)
    (note,) = implausible_data({"creep": said})
    # What the reader has said is not said again.
    assert implausible_data({"creep": replace(said, notes=[note])}) == []
    (text,) = implausible_data({"dynamics": recording})
    assert "too slow to hold dynamics" in text
    assert implausible_data({"creep": recording}) == []


@pytest.mark.parametrize(("made", "said"), [
    ({"time_constant_s": 2.7}, "a lag of 2.7 s is too slow .* is dyn a recording"),
    ({"mode_frequencies_rad_per_s": (3.0,), "damping_ratios": (0.5,)}, "a mode at 0.477 Hz"),
    ({"range_um": 0.133}, "a range of 0.133 um over 100 V is implausible"),
    ({"range_um": 3e4}, "a range of 3e.04 um"),
    ({"range_v": 1e5}, "voltages from 0 to 1e.05 V are implausible"),
])
def test_an_implausible_model_is_told(recorded, made, said):
    recordings = {"dynamics": recorded("dyn", SQUARE_V, SQUARE_V, 1e-3)}
    assert re.search(said, " ".join(implausible_model(model(**made), recordings)))


@pytest.mark.parametrize("made", [
    {}, {"range_um": 0.3, "range_v": 3.0}, {"range_um": 1500.0}, {"range_um": 1.0},
    {"mode_frequencies_rad_per_s": (60.0,), "damping_ratios": (0.05,)}])
def test_a_plausible_model_is_not_told_of(recorded, made):
    recordings = {"dynamics": recorded("dyn", SQUARE_V, SQUARE_V, 1e-3)}
    assert implausible_model(model(**made), recordings) == []


def test_a_time_constant_that_coupled_modes_compensate_is_plausible(recorded):
    coupled = replace(model(time_constant_s=0.06), effects=(
        CoupledMode(2500.0, 0.02, 0.4, 90.0), CoupledMode(5600.0, 0.02, 0.6, 130.0)))
    recordings = {"dynamics": recorded("dyn", SQUARE_V, SQUARE_V, 1e-3)}
    assert implausible_model(coupled, recordings) == []
    lagging = replace(model(), effects=(AmplifierLag(0.06),))
    assert "a lag of 0.0605 s is too slow" in implausible_model(lagging, recordings)[0]


@pytest.mark.parametrize(("gain", "said"), [(2.9, []), (2900.0, ["a gain of 2.9e+03 um/V is"])])
def test_a_response_has_a_gain_but_no_range(gain, said):
    response = FrequencyResponse("r.csv", np.array([1.0, 2.0]), np.full(2, gain + 0j))
    told = implausible_model(model(2000.0 * gain, 2000.0), {"dynamics": response})
    assert [text[: len("a gain of 2.9e+03 um/V is")] for text in told] == said
