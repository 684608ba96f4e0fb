# SPDX-License-Identifier: BSD-3-Clause
"""A line in place of a hysteresis: plays that NumPy alone has made, behind a mode of SciPy's."""

import numpy as np
import pytest
from made_by_scipy import behind_mode, behind_play, line_model, logged, smooth_noise_v

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.effect_fit import fit_one_more
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import first_regression
from piezo_identification.prediction import predict
from piezo_models.effects.hysteresis import Hysteresis

SAMPLES, NOISE_UM = 4000, 5e-3
MODE_RAD_PER_S, DAMPING_RATIO = 700.0, 0.1
HALF_WIDTHS_V, GAINS_UM_PER_V = (2.0, 5.5, 9.0, 17.0, 25.0), (0.03, 0.02, 0.03, 0.01, 0.02)
LINE = line_model(MODE_RAD_PER_S, DAMPING_RATIO, gain_um_per_v=0.6)


def plays_um(voltage_v, way_up=0.0):
    """Return a gain and plays, whose outputs are bent where the way up is to be another one."""
    total_um = 0.5 * voltage_v
    for half_width, gain in zip(HALF_WIDTHS_V, GAINS_UM_PER_V, strict=True):
        played = behind_play(voltage_v, 2.0 * half_width)
        total_um += gain * played * (1.0 + way_up * played / 50.0)
    return total_um


def recording(seed, hysteresis=plays_um):
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, 120)
    displacement_um = behind_mode(hysteresis(voltage_v), MODE_RAD_PER_S, DAMPING_RATIO)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um, name=f"seed {seed}")


def error_um(model, unseen):
    prediction = predict(model, unseen)
    return np.std((prediction.measured_um - prediction.simulated_um)[prediction.good])


def test_the_hysteresis_that_a_line_lacks_is_named_and_predicts_another_recording():
    diagnosis = diagnose(LINE, [recording(1)])
    assert [entry["name"] for entry in diagnosis.effects] == ["hysteresis"]
    unseen = recording(2)
    assert error_um(diagnosis.model, unseen) < 0.15 * error_um(LINE, unseen)


@pytest.mark.parametrize("hysteresis", [
    plays_um, lambda voltage_v: plays_um(voltage_v, 0.5)], ids=["symmetric", "asymmetric"])
def test_the_plays_explain_a_hysteresis_of_either_symmetry(hysteresis):
    regression = first_regression(simulate_recordings(LINE, [recording(1, hysteresis)]))
    fit = fit_one_more(regression, Hysteresis, (), recording_evidence(regression))
    held_out = regression.validation
    assert np.std(fit.residual[held_out]) < 0.1 * np.std(regression.fit(()).residual[held_out])
    assert fit.effects[0].impossible(regression.dataset.extent) is None


def test_no_plays_are_guessed_where_the_stage_has_none():
    regression = first_regression(simulate_recordings(
        LINE, [recording(1, lambda voltage_v: 0.6 * voltage_v + 1e-4 * voltage_v**2)]))
    (shown,) = recording_evidence(regression)
    assert Hysteresis.starts(shown) == []


def test_a_voltage_that_does_not_turn_around_shows_no_hysteresis():
    (shown,) = recording_evidence(first_regression(simulate_recordings(LINE, [recording(1)])))
    assert Hysteresis.lacks_excitation(shown) is None
    rising = vars(shown) | {"voltage_v": np.linspace(0.0, 50.0, SAMPLES)}
    assert "turn around" in Hysteresis.lacks_excitation(type(shown)(**rising))
