# SPDX-License-Identifier: BSD-3-Clause
"""Feedbacks by their names on a stage with a light mode, against python-control."""

import control
import numpy as np
import pytest

from piezo_controller.feedback.controller_file import load_stabilising_controller, save_controller
from piezo_controller.feedback.feedback_design import UnstableLoop
from piezo_controller.feedback.onboard_law import onboard_law
from piezo_controller.feedback.sample_rate import perturbed_loops
from piezo_controller.feedback.sample_rate.named_feedbacks import (
    ERRORS,
    comparison_figure,
    comparison_table,
    feedback_at_margin,
)
from piezo_controller.feedback.sample_rate.perturbed_loops import PerturbedLoops
from piezo_controller.feedback.sample_rate.repetitive import Repetitive
from piezo_controller.feedback.synthesis.design_choices import FEEDBACKS
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.law_check import check_law
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S, FREQUENCY_HZ, PEAK = 25e-6, 20.0, 2.0


@pytest.fixture(scope="module", autouse=True)
def few_frequencies():
    """Take half as many about the peak, where most of the time goes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(perturbed_loops, "OVER_PEAK", 1.5)
        yield


@pytest.fixture(scope="module")
def light():
    """Return a line and one mode at 800 Hz with a damping ratio of 0.01."""
    return StageModel(
        PreisachModel(-20.0, 120.0, np.zeros((1, 1)), 0.0, np.array([0.9])), CreepDynamics(),
        ElectricVibrationDynamics(0.0, (5026.0,), (0.01,)))


@pytest.fixture(scope="module")
def designed(light):
    return {name: feedback_at_margin(name, light, FREQUENCY_HZ, PEAK, effort=0.15)
            for name in ("pi", "integral-resonant")}


def test_all_have_the_same_margin_and_damping_beats_pi(light, designed):
    plants = PerturbedLoops(light, ERRORS, PERIOD_S, (FREQUENCY_HZ,), delay_ticks=0).plants[::16]
    points = np.exp(2j * np.pi * PERIOD_S * np.geomspace(1.0, 19_000.0, 2_500))
    for controller in designed.values():
        response = controller.state_space()(points, squeeze=True)
        loops = np.array([plant(points, squeeze=True) * response for plant in plants])
        assert np.abs(1.0 / (1.0 + loops)).max() == pytest.approx(PEAK, rel=0.02)
        assert all(np.abs(control.feedback(plant * controller.state_space(), 1).poles()).max() < 1.0
                   for plant in plants)
    gained = {name: controller.report["margin_db"] for name, controller in designed.items()}
    assert gained["pi"] < 1.0 < 5.0 < gained["integral-resonant"]


def test_a_file_keeps_a_law_that_the_stage_accepts(light, designed, tmp_path):
    reference = Reference("harmonic", (100.0,), (10.0,), (), 50.0)
    plan = plan_feedforward(sample_reference(reference), light, duration_s=0.1)
    for controller in designed.values():
        save_controller(tmp_path / "controller.json", controller)
        loaded = load_stabilising_controller(
            tmp_path / "controller.json", light, PERIOD_S, PERIOD_S)
        np.testing.assert_array_equal(loaded.A, controller.A)
        assert (loaded.delay_ticks, loaded.sample_period_s) == (0, PERIOD_S)
        check_law(onboard_law(loaded, light, plan, PERIOD_S, 20.0, True), samples_per_tick=40)


def test_table_and_picture_have_each_feedback(light, designed):
    table = comparison_table(designed)
    assert [row[0] for row in table.rows] == list(designed)
    axes, = comparison_figure(light, designed).axes
    assert [line.get_label() for line in axes.lines[:-1]] == list(designed)
    sensitivity = dict(zip(*axes.lines[1].get_data(), strict=True))
    at_hz = min(sensitivity, key=lambda hz: abs(hz - FREQUENCY_HZ))
    assert -20.0 * np.log10(sensitivity[at_hz]) == pytest.approx(table.rows[1][2], abs=0.5)


def test_what_repeats_in_no_whole_number_of_samples_is_attenuated():
    damped = StageModel(
        PreisachModel(-20.0, 120.0, np.zeros((1, 1)), 0.0, np.array([0.9])), CreepDynamics(),
        ElectricVibrationDynamics(0.00049, (2846.0,), (0.7,)))
    frequency_hz = 70.3  # 568.99 samples
    made = Repetitive(damped, frequency_hz, PERIOD_S)
    assert made.frequencies_hz == pytest.approx(frequency_hz * np.arange(1, 7))
    system = made.controller(np.array([0.05, 0.03, 0.05]))
    plant = PerturbedLoops(damped, ERRORS, PERIOD_S, (20.0,), delay_ticks=0).plants[0]
    sensitivity = control.feedback(1, plant * system)
    assert np.abs(sensitivity.poles()).max() < 1.0
    time_s = PERIOD_S * np.arange(40_000)
    disturbance_um = sum(np.sin(2.0 * np.pi * multiple * frequency_hz * time_s) / multiple
                         for multiple in (1, 2, 3))
    left_um = control.forced_response(sensitivity, inputs=disturbance_um).outputs[-4000:]
    assert np.std(left_um) < 0.01 * np.std(disturbance_um)


def test_margin_that_no_gain_has_and_frequency_above_the_mode_are_refused(light):
    with pytest.raises(ValueError, match="lies above the first mode"):
        feedback_at_margin("repetitive", light, 900.0)
    with pytest.raises(UnstableLoop, match="no gain of pi has a peak sensitivity of 1"):
        feedback_at_margin("pi", light, FREQUENCY_HZ, 1.0000001, effort=0.01)


@pytest.mark.long
@pytest.mark.parametrize("name", FEEDBACKS)
def test_each_feedback_ends_at_the_margin(name, light):
    figures = feedback_at_margin(name, light, FREQUENCY_HZ).report["figures"]
    assert figures["worst_peak_sensitivity"] == pytest.approx(PEAK, rel=2e-3)
