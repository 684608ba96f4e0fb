# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_controller.commands import axes_design_work
from piezo_controller.commands.design_command import main
from piezo_controller.feedback import feedback_design
from piezo_controller.feedback.axes_design import (
    axes_plant_errors,
    design_axes_feedback,
    gain_spreads,
    linear_part,
    scaled_plant,
    with_mode_errors,
)
from piezo_controller.feedback.loop_measures import measure_axes_loop, sensitivity_of_axes
from piezo_controller.feedback.robustness import PlantErrors, Robustness
from piezo_controller.feedback.synthesis.dk_iteration import scale
from piezo_controller.feedback.synthesis.generalised_plant import generalised_plant, lift
from piezo_controller.feedback.synthesis.h_infinity import synthesise
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
from piezo_models.axes_model_file import save_axes_model
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.feedback_law.axes_law import load_axes_law
from piezo_models.feedback_law.law_check import check_law
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S, TICK_S = 2.5e-4, 1e-3
ACTUATOR = Actuator(
    PreisachModel(0.0, 100.0, np.tril(np.full((4, 4), 4e-4)), 0.0, np.full(4, 0.15)),
    CreepDynamics((0.05, 4.0), (0.052, 4.2)))


def model_of(frequency_hz=(300.0, 400.0), push=((0.2, 0.006), (-0.005, 0.2))):
    """Two modes, each pushed a little by the other axis, behind hysteresis and creep."""
    s = control.tf("s")
    modes = [control.ss(w**2 / (s**2 + 0.03 * w * s + w**2))
             for w in 2.0 * np.pi * np.array(frequency_hz)]
    stage = control.append(*modes) * control.ss([], [], [], push)
    system = control.sample_system(stage, PERIOD_S)
    return replace(CoupledModel.from_control(
        system, ("x", "y"), [50.0, 50.0], [10.0, 10.0]), actuators=(ACTUATOR, ACTUATOR))


def test_gain_of_loops_that_drift_spreads_from_that_after_a_reversal_to_one():
    drifting = Actuator(PreisachModel.line(0.0, 100.0, 0.2),
                        bouc_wen=BoucWenHysteresis(3.0, 20.0, unloading=1.0))
    spreads = gain_spreads(replace(model_of(), actuators=(drifting, ACTUATOR)))
    assert spreads[0] == pytest.approx(1.0 / 0.85 - 1.0)


@pytest.fixture(scope="module")
def model():
    return model_of()


@pytest.fixture(scope="module")
def law(model, short_search):
    return design_axes_feedback(model, load_weights())


def controller_of(law, model):
    _, gains_um_per_v = scaled_plant(model, TICK_S)
    return np.diag(gains_um_per_v) * control.ss(*law.tick.matrices, TICK_S)


@pytest.mark.usefixtures("few_draws")
def test_law_closes_a_stable_loop_of_all_axes_at_every_gain(law, model):
    assert gain_spreads(model) == pytest.approx([0.04, 0.04], abs=0.03)
    assert law.plant.gains_um_per_v.shape == (9, 2)
    path_um = np.zeros((1, 2))
    check_law(law.following(path_um, path_um[:0], 0, 20.0), law.samples_per_tick)
    assert law.report["mu"] < 1.0
    robustness = axes_plant_errors(model, TICK_S).robustness(controller_of(law, model))
    assert robustness.unstable_samples == 0


def test_report_has_the_measures_of_the_sensitivity(law, model):
    plant, report = scaled_plant(model, TICK_S)[0], law.report
    controller = controller_of(law, model)
    at_hz = np.array([report["bandwidth_hz"], report["peak_frequency_hz"], 1.0])
    edge, peak, slow = np.linalg.norm(sensitivity_of_axes(plant, controller, at_hz), 2, (1, 2))
    assert edge == pytest.approx(1 / np.sqrt(2), rel=0.01)
    assert peak == pytest.approx(report["peak_sensitivity"])
    assert slow < 0.02 and report["bandwidth_hz"] > 30.0
    assert set(report["bandwidth_hz_of_axis"]) == {"x", "y"}


@pytest.mark.parametrize("turn", [
    [1, -1], *(pytest.param(turn, marks=pytest.mark.long) for turn in ([1, 1], [-1, -1]))])
def test_margins_hold_for_gains_and_phases_that_change_independently(law, model, turn):
    plant, controller = scaled_plant(model, TICK_S)[0], controller_of(law, model)
    report = measure_axes_loop(plant, controller, model.axes)
    gain = (0.99 * report["gain_margin"]) ** np.array(turn)
    assert np.abs(control.feedback(
        np.diag(gain) * plant * controller, np.eye(2)).poles()).max() < 1.0
    points = np.exp(2j * np.pi * np.geomspace(0.1, 500.0, 2000) * TICK_S)
    loop = np.moveaxis((plant * controller)(points), -1, 0)
    # Stable as long as no frequency is passed at which the loop would be on the edge.
    for part in np.linspace(0.0, 0.99, 20):
        phase = np.exp(1j * np.radians(part * report["phase_margin_deg"]) * np.array(turn))
        assert np.linalg.norm(np.eye(2) + phase[:, None] * loop, -2, axis=(1, 2)).min() > 0.01


def test_problem_of_two_equal_uncoupled_axes_has_the_norm_of_one():
    whole = model_of((300.0, 300.0), ((0.2, 0.0), (0.0, 0.2)))
    both = generalised_plant(scaled_plant(whole, TICK_S)[0], 1.0, load_weights())
    one = lift(linear_part(whole)[0, 0] * (
        1.0 / scaled_plant(whole, TICK_S)[1][0]), round(TICK_S / PERIOD_S), 0)
    alone = generalised_plant(one, 1.0, load_weights())
    scalings = [1.2, 0.6]
    _, norm_of_both = synthesise(scale(both, scalings, 2), tolerance=1e-3, axes=2)
    _, norm_of_one = synthesise(scale(alone, scalings), tolerance=1e-3)
    assert norm_of_both == pytest.approx(norm_of_one, rel=2e-3)


def test_lifted_plant_of_two_axes_is_the_lifted_plant_of_each_entry(model):
    linear = linear_part(model)
    for delay_ticks in (0, 1, 2):
        whole = lift(linear, 4, delay_ticks)
        z = np.exp(0.3j)
        entries = [[lift(linear[i, j], 4, delay_ticks)(z) for j in range(2)] for i in range(2)]
        assert np.allclose(whole(z), entries, rtol=1e-9)


def test_linear_part_is_the_response_of_modes_and_creep_at_the_middle_gain(model):
    frequency_hz = np.array([0.01, 3.0, 290.0])
    points = np.exp(2j * np.pi * frequency_hz * PERIOD_S)
    creep = ACTUATOR.creep_response(frequency_hz, PERIOD_S)
    expected = model.response(frequency_hz) * creep[:, None, None]
    found = np.moveaxis(linear_part(model)(points), -1, 0)
    ratio = found / expected
    assert np.allclose(ratio, ratio[0, 0, 0], rtol=1e-9) and 0.9 < ratio[0, 0, 0].real < 1.1


def test_direct_part_acts_on_the_next_sample(model):
    direct_um_per_v = np.array([[[0.02, 0.001], [0.0, 0.03]]])
    direct = replace(model, direct_um_per_v=direct_um_per_v, actuators=())
    without = replace(direct, direct_um_per_v=0.0 * direct_um_per_v)
    z = np.exp(0.3j)
    assert not linear_part(direct).D.any()
    assert np.allclose(linear_part(direct)(z) - linear_part(without)(z), direct_um_per_v[0] / z)


def test_errors_of_a_mode_change_its_frequency_damping_and_share(model):
    errors = np.zeros((3, 2))
    errors[:, 0] = 0.05, -0.1, 0.2
    off = with_mode_errors(model, errors)
    before, after = model.poles_rad_per_s, off.poles_rad_per_s
    assert after[0].imag == pytest.approx(1.05 * before[0].imag)
    assert after[0].real == pytest.approx(1.05 * 0.9 * before[0].real)
    assert after[1] == before[1]
    same = with_mode_errors(model, np.zeros((3, 2))).response(0.0)
    assert np.allclose(same, model.response(0.0))
    moved = np.argmax(np.abs((off.response(0.0) - same)[0].real).max(axis=1))
    assert off.response(0.0)[0, moved, moved] == pytest.approx(
        1.2 * same[0, moved, moved], rel=0.05)


def test_robustness_finds_the_worst_of_the_largest_errors():
    plant = control.ss([[0.5]], [[1.0]], [[0.5]], 0.0, TICK_S)
    errors = PlantErrors(
        lambda errors: plant * (1.0 + 0.1 * errors[0]) * (1.0 + 0.1 * errors[1]), 2)
    found = errors.robustness(control.ss([[0.0]], [[0.0]], [[0.0]], [[1.0]], TICK_S), 20)
    assert found == Robustness(20, 0, pytest.approx(1 / (1 - 0.5 * 1.21 / 1.5), rel=0.01))


def test_tick_that_is_no_multiple_of_the_sample_period_is_refused(model):
    with pytest.raises(ValueError, match="no multiple of the model's sample period of 0.00025 s"):
        design_axes_feedback(model, load_weights().at_tick(1.1e-3))


@pytest.fixture
def model_file(tmp_path, model):
    nothing, modes = np.zeros((2, 2)), model.poles_rad_per_s.size
    save_axes_model(tmp_path / "model.json", IdentifiedAxes(
        model, np.tile([0.0, 100.0], (2, 1)),
        Coupling(np.ones(1), nothing[None] + 0j, nothing[None] + 0j), np.zeros(modes, complex),
        np.zeros((modes, 2, 2), complex), np.zeros(2), np.zeros(2)))
    return tmp_path / "model.json"


@pytest.mark.usefixtures("few_draws")
def test_command_writes_the_law_its_picture_and_its_page(
        model_file, law, tmp_path, capsys, monkeypatch):
    asked = []

    def designed(model, weights, *_):
        asked.append(weights)
        return law

    monkeypatch.setattr(axes_design_work, "design_axes_feedback", designed)
    monkeypatch.setattr(axes_design_work, "DRAWN", 5)
    monkeypatch.setattr(feedback_design, "FREQUENCIES", 40)
    assert main(["--model", str(model_file), "--disturbance-hz", "10",
                 "--output", str(tmp_path / "law.json")]) == 0
    printed = capsys.readouterr().out
    assert asked == [load_weights().for_disturbances(10.0).at_tick(TICK_S)]
    assert "bandwidth of y" in printed and "20 of 20 drawn" in printed
    assert load_axes_law(tmp_path / "law.json").axes == ("x", "y")
    page = (tmp_path / "law_report.html").read_text()
    assert "may change independently" in page
    assert (tmp_path / "law_sensitivity.png").stat().st_size > 10_000


def test_command_refuses_what_is_of_one_axis(model_file, tmp_path, capsys):
    assert main(["--model", str(model_file), "--method", "pid",
                 "--output", str(tmp_path / "law.json")]) == 2
    assert "--method is of one axis" in capsys.readouterr().err
