# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of recordings that SciPy alone has made: sign, drop-outs, ringing, springs, vetoes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, smooth_noise_v
from scipy.integrate import solve_ivp
from scipy.signal import sawtooth

from piezo_identification.commands.diagnose_command import main as diagnose_main
from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.commands.simulate_command import main as simulate_main
from piezo_identification.conditioning.outlier_samples import good_samples, with_outliers_marked
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.report.diagnosis_report import verdict_sentence
from piezo_identification.prediction import predict
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.reader import read_recording

pytestmark = pytest.mark.usefixtures("without_ceiling", "likely_effects")

NOISE_UM = 2e-3
PERIOD_S = 1e-3
MODE_RAD_PER_S, DAMPING_RATIO = 400.0, 0.05


def smooth_noise(seed, samples=4000):
    """Return the voltage without anything fast, and from rest."""
    return smooth_noise_v(np.random.default_rng(seed), samples, 60)


def answered(voltage_v, cubic=0.0):
    """Return the displacement of a mass on a spring, by an integrator with a cubic part, (N,)."""
    w, z = MODE_RAD_PER_S, DAMPING_RATIO
    if not cubic:
        return behind_mode(0.1 * voltage_v, w, z)

    def motion(t, state):
        held_v = voltage_v[min(int(t / PERIOD_S + 1e-9), voltage_v.size - 1)]
        x, speed = state
        return speed, w * w * (0.1 * held_v - x - cubic * x**3) - 2.0 * z * w * speed

    time_s = np.arange(voltage_v.size) * PERIOD_S
    return solve_ivp(motion, (0.0, time_s[-1]), (0.0, 0.0), "RK45", time_s, rtol=1e-6,
                     atol=1e-8, max_step=PERIOD_S).y[0]


def with_noise(displacement_um, seed=9):
    return displacement_um + NOISE_UM * np.random.default_rng(seed).normal(
        size=displacement_um.size)


@pytest.fixture
def save(tmp_path, save_csv):
    def save_recording(name, voltage_v, displacement_um):
        path = tmp_path / f"{name}.csv"
        save_csv(path, np.arange(voltage_v.size) * PERIOD_S, voltage_v, displacement_um)
        return path

    return save_recording


@pytest.fixture
def swinging():
    return line_model(MODE_RAD_PER_S, DAMPING_RATIO)


@pytest.mark.usefixtures("without_pictures")
def test_a_sensor_that_counts_down_lacks_nothing(save, swinging, tmp_path, capsys):
    voltage_v = smooth_noise(1)
    path = save("down", voltage_v, with_noise(-answered(voltage_v)))
    unseen = save("unseen", smooth_noise(2), with_noise(-answered(smooth_noise(2))))
    model, output = tmp_path / "model.json", tmp_path / "out"
    save_model(model, IdentifiedModel(swinging, (-100.0, 100.0)))
    assert diagnose_main(["--model", str(model), "--data", str(path), "--holdout", str(unseen),
                          "--output", str(output)]) == 0
    told = capsys.readouterr().out
    verdict = json.loads((output / "verdict.json").read_text())
    assert (verdict["verdict"], verdict["effects"]) == ("none", [])
    assert verdict["reversed"] == [str(path), str(unseen)]
    assert verdict["before"] == verdict["after"]
    assert told.count("its sign is changed") == 2
    assert simulate_main(["--model", str(model), "--data", str(path)]) == 0
    assert "its sign is changed" in capsys.readouterr().out


def triangles(samples=6000):
    voltage_v = 40.0 * sawtooth(2.0 * np.pi * np.arange(samples) / 600.0, 0.5) * np.repeat(
        np.linspace(1.0, 0.3, 10), samples // 10)
    return voltage_v, 0.1 * voltage_v + 6.0


def test_tips_of_triangles_stay_where_they_are(save):
    recording = read_recording(save("straight", *triangles()))
    kept = with_outliers_marked(recording)
    assert good_samples(kept).all()
    np.testing.assert_array_equal(kept.displacement_um, recording.displacement_um)


def dropped_out(displacement_um, share=0.015, seed=3, to_um=0.0):
    generator = np.random.default_rng(seed)
    wrong = np.zeros(displacement_um.size, dtype=bool)
    while wrong.mean() < share:
        begin = generator.integers(0, wrong.size)
        wrong[begin : begin + generator.integers(1, 8)] = True
    return np.where(wrong, to_um, displacement_um), wrong


def loops(samples=4000):
    """Return the voltage over the whole range, and what a few play operators make of it."""
    time = np.arange(samples)
    voltage_v = -50.0 * np.cos(2.0 * np.pi * time / (samples / 6)) * np.linspace(1.0, 0.4, samples)
    displacement_um = 0.05 * voltage_v + 12.0
    for half_width_v in (3.0, 9.0, 20.0):
        last = -50.0 + half_width_v
        for n, level in enumerate(voltage_v):
            last = min(max(last, level - half_width_v), level + half_width_v)
            displacement_um[n] += 0.02 * last
    return voltage_v, displacement_um


@pytest.mark.usefixtures("without_search")
def test_drop_outs_change_neither_model_nor_errors(save, tmp_path, capsys):
    voltage_v, displacement_um = loops()
    clean_um = with_noise(displacement_um)
    broken_um, wrong = dropped_out(clean_um)
    models, errors = [], []
    truth = read_recording(save("truth", voltage_v, displacement_um))
    for name, measured_um in (("clean", clean_um), ("broken", broken_um)):
        path, model = save(name, voltage_v, measured_um), tmp_path / f"{name}.json"
        assert identify_main(["--no-report", "--grid", "40", "--smoothing", "1e-10",
                              "--translation-weight", "1e-10", "--hysteresis", str(path),
                              "--validation", str(path), "--output", str(model)]) == 0
        told = capsys.readouterr().out
        assert ("are outliers or clipped, and were left out" in told) == (name == "broken")
        models.append(load_model(model))
        errors.append(models[-1].errors["e_y_percent"])
        assert simulate_main(["--model", str(model), "--data", str(path)]) == 0
        assert ("are outliers" in capsys.readouterr().out) == (name == "broken")
    assert errors[1] == pytest.approx(errors[0], rel=0.05)
    of_truth = [predict(model.model, truth).e_y_percent() for model in models]
    assert of_truth[1] < 1.2 * of_truth[0]


def test_drop_outs_are_named_and_nothing_else_is_lacking(save, swinging):
    voltage_v = smooth_noise(1, 6000)
    clean_um = with_noise(answered(voltage_v))
    broken_um, wrong = dropped_out(clean_um, to_um=-8.0)
    diagnosis = diagnose(swinging, [read_recording(save("clean", voltage_v, clean_um)),
                                    read_recording(save("broken", voltage_v, broken_um))])
    assert diagnosis.verdict == "explained"
    (entry,) = diagnosis.effects
    assert entry["name"] == "outliers"
    assert entry["parameters"]["share"] == pytest.approx(0.5 * wrong.mean(), rel=0.1)
    assert [effect.name for effect in diagnosis.model.effects] == ["outliers"]
    assert diagnosis.after["rms_um"] <= diagnosis.before["rms_um"] < 1.2 * NOISE_UM
    assert len(diagnosis.left_out) == 1 and "broken.csv" in diagnosis.left_out[0]
    assert "falls" not in verdict_sentence(diagnosis)


@pytest.mark.long
def test_the_ringing_of_a_strong_mode_is_not_left_out(save):
    """1.5 kHz with 9 % of the compliance, at 40 kHz, beside a model without any mode."""
    samples, period_s = 12_000, 25e-6
    voltage_v = np.where((np.arange(samples) // 1000) % 2, 40.0, -40.0)
    ringing = behind_mode(voltage_v + 40.0, 2.0 * np.pi * 1500.0, 0.015, period_s) - 40.0
    late_v = np.r_[voltage_v[0], voltage_v[:-1]]
    measured_um = with_noise(0.1 * (0.91 * late_v + 0.09 * ringing))
    recording = replace(
        read_recording(save("ringing", voltage_v, measured_um)), sample_rate_hz=1.0 / period_s,
        sample_periods_s=np.full(samples, period_s))
    prediction = predict(line_model(), recording)
    assert not prediction.outlier.any()
    diagnosis = diagnose(line_model(), [recording])
    assert diagnosis.left_out == []
    assert "outliers" not in [entry["name"] for entry in diagnosis.effects]


@pytest.mark.long
def test_a_cubic_spring_is_found_and_holds_far_beyond_its_data(save, swinging):
    weak_v, strong_v = 0.8 * smooth_noise(1, 3000), 1.3 * smooth_noise(2, 2000)
    fitted, unseen = (
        read_recording(save(name, voltage_v, with_noise(answered(voltage_v, 0.02))))
        for name, voltage_v in (("weak", weak_v), ("strong", strong_v)))
    diagnosis = diagnose(swinging, [fitted], unseen)
    assert diagnosis.effects[0]["name"] == "stiffening"
    assert diagnosis.after["rms_um"] < 0.1 * diagnosis.before["rms_um"]


@pytest.mark.long
def test_all_parameters_of_the_model_are_fitted_beside_the_effects_found(save):
    """The linear part of a stage with a spring is wrong, as it was fitted without the spring."""
    wrong = line_model(1.03 * MODE_RAD_PER_S, 1.2 * DAMPING_RATIO, gain_um_per_v=0.097)
    fitted, unseen = (
        read_recording(save(f"seed_{seed}", voltage_v, with_noise(answered(voltage_v, 0.02), seed)))
        for seed in (1, 2) for voltage_v in [3.0 * np.repeat(smooth_noise(seed)[::10], 5)])
    diagnosis = diagnose(wrong, [fitted], unseen)
    assert [entry["name"] for entry in diagnosis.effects] == ["stiffening"]
    # The true parameters leave as much: a simulation knows the load at its samples only.
    assert diagnosis.after["rms_um"] < 3.0 * NOISE_UM
    [mode] = diagnosis.model.dynamics.mode_frequencies_rad_per_s
    [ratio] = diagnosis.model.dynamics.damping_ratios
    [spring] = diagnosis.model.effects
    at_rest = -spring.centre_um / spring.half_range_um
    linear = np.polyval([4.0 * spring.quartic_um, 3.0 * spring.cubic_um, 2.0 * spring.square_um,
                         spring.linear_um], at_rest) / spring.half_range_um
    assert mode * np.sqrt(1.0 + linear) == pytest.approx(MODE_RAD_PER_S, rel=1e-3)
    assert mode * (2.0 * ratio + spring.viscous) == pytest.approx(
        2.0 * DAMPING_RATIO * MODE_RAD_PER_S, rel=2e-2)


def test_what_makes_held_out_data_worse_is_not_added(save, swinging):
    """A cubic sensor error that is not there on the day of the other recording."""
    voltage_v = smooth_noise(1)
    displacement_um = answered(voltage_v)
    bent_um = displacement_um - 0.004 * displacement_um**3
    fitted = read_recording(save("bent", voltage_v, with_noise(bent_um)))
    unseen = read_recording(save("straight", voltage_v, with_noise(displacement_um, 10)))
    alone = diagnose(swinging, [fitted])
    assert alone.verdict == "explained" and alone.effects
    diagnosis = diagnose(swinging, [fitted], unseen)
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.effects == [] and diagnosis.model is swinging
    assert diagnosis.before == diagnosis.after
    assert any("rises from" in reason for reason in diagnosis.not_decidable.values())
    assert "falls" not in verdict_sentence(diagnosis)


def test_what_comes_before_the_model_has_settled_is_not_told_as_outliers(save, swinging):
    """The first samples of a recording that begins in motion do not count, but are no outliers."""
    voltage_v = smooth_noise(1)
    displacement_um = with_noise(answered(voltage_v))
    whole = read_recording(save("whole", voltage_v, displacement_um))
    moving = read_recording(save("moving", voltage_v[2000:], displacement_um[2000:]))
    diagnosis = diagnose(swinging, [whole], moving)
    assert diagnosis.holdout["samples"] < moving.voltage_v.size
    assert diagnosis.left_out == []


def test_no_drift_goes_farther_than_the_sensor_saw(save, swinging):
    voltage_v = smooth_noise(1)
    slow_um = 0.4 * (np.arange(voltage_v.size) / voltage_v.size) ** 2
    recording = read_recording(save("slow", voltage_v, with_noise(answered(voltage_v) + slow_um)))
    diagnosis = diagnose(swinging, [recording])
    travel_um = np.ptp(recording.displacement_um)
    for entry in diagnosis.effects:
        if entry["name"] == "thermal_drift":
            parameters = entry["parameters"]
            assert abs(parameters["approach_um"]) <= 2.0 * travel_um
            assert abs(parameters["rate_um_per_s"]) * 4.0 <= 2.0 * travel_um * (1.0 + 1e-9)
            break
    else:
        pytest.fail(f"no drift was found: {diagnosis.effects}")
