# SPDX-License-Identifier: BSD-3-Clause
"""One fit of the whole model: it corrects every component, and finds the right structure."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.structure_search import (
    FLAT,
    begun,
    best_of,
    has_amplifier,
    is_at_noise,
    is_better,
    is_pointless,
    promising,
    searched,
    starts,
    structures,
)
from piezo_identification.fitting.whole_model import WIDE_PRIOR, WholeModel
from piezo_identification.prediction import unseen_errors
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

pytestmark = pytest.mark.kernels

LAG_S, NOISE_UM = 3e-4, 0.009


@pytest.fixture(scope="module")
def recordings(play):
    return [with_outliers_marked(each) for each in (
        play(experiments.creep(period_s=60.0), 1, 100.0),
        play(experiments.dynamics(duration_s=0.2), 1),
        play(experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0))]


def steps_and_loops(play, stage):
    """Record the dynamics and the hysteresis of a stage."""
    return [play(experiments.dynamics(duration_s=0.1), 1, stage=stage),
            play(experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0,
                 stage=stage)]


@pytest.fixture(scope="module")
def unseen(play):
    return play(experiments.validation(arc_s=0.05, tones_s=0.2), 2)


@pytest.fixture(scope="module")
def wrong(plant):
    """The plant with errors in every component."""
    density = plant.hysteresis.density_um_per_v2
    tilt = 1.0 + np.linspace(-0.03, 0.03, len(density))[:, None]
    return replace(
        plant,
        hysteresis=replace(plant.hysteresis, density_um_per_v2=density * tilt),
        creep=CreepDynamics((0.0145, 0.165, 1.08, 17.0), (0.0149, 0.1685, 1.1, 17.8)),
        dynamics=ElectricVibrationDynamics(0.0005, (2800.0, 4930.0), (0.70, 0.085)),
    )


def sought(problem, model):
    found, tried = begun(problem, model, None)
    best = best_of([fit for _, fit in found])
    best, more = searched(next(where for where, fit in found if fit is best), best)
    return best, tried + more


@pytest.fixture(scope="module")
def corrected(wrong, recordings):
    return sought(WholeModel(wrong, recordings, [0.0] * 3), wrong)


def test_one_fit_corrects_every_component(plant, corrected):
    model = corrected[0].model
    frequency_hz = np.geomspace(0.01, 2000.0, 200)
    ratio = model.response(frequency_hz) / plant.response(frequency_hz)
    np.testing.assert_allclose(np.abs(ratio), 1.0, atol=2e-2)
    np.testing.assert_allclose(
        model.hysteresis.output_range_um[1], plant.hysteresis.output_range_um[1], rtol=2e-3)


def test_one_fit_is_as_good_on_another_input(wrong, corrected, unseen):
    before, after = unseen_errors(wrong, unseen), unseen_errors(corrected[0].model, unseen)
    assert after["e_y_percent"] < 0.3 * before["e_y_percent"]


def test_the_standard_deviations_cover_the_errors_of_the_fast_dynamics(plant, corrected):
    fit = corrected[0]
    deviations = fit.deviations()[0]["dynamics"]
    for name in ("time_constant_s", "mode_frequencies_rad_per_s", "damping_ratios"):
        error = np.subtract(getattr(fit.model.dynamics, name), getattr(plant.dynamics, name))
        assert np.all(np.abs(error) < 4.0 * np.array(deviations[name])), name
        assert np.all(np.array(deviations[name]) < 0.05 * np.abs(getattr(fit.model.dynamics, name)))


def test_nothing_that_was_tried_has_more_evidence_and_held_out_rows_that_agree(corrected):
    best, tried = corrected
    assert not any(is_better(fit, best) for _, fit in tried if fit is not best)


@pytest.fixture
def lagging(wrong, recordings):
    """A problem, and a fit of it whose effects are not the best ones yet."""
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    model = replace(wrong, effects=(AmplifierLag(LAG_S), VibrationMode(7000.0, 0.05, 0.1)))
    return problem, problem.fit(model, None, 1)


def test_a_fit_shares_the_derivatives_by_the_effects_with_similar_models(lagging, monkeypatch):
    problem, fit = lagging
    without = problem.again(fit, 1)
    problem.about(fit)
    computed = []
    simulate = SimulatedRecording.simulate
    monkeypatch.setattr(SimulatedRecording, "simulate", lambda part, *effects, **rows: (
        computed.append(effects), simulate(part, *effects, **rows))[1])
    again = problem.again(fit, 1)
    # Each recording is simulated at both points, and with its linear part, but for no parameter.
    assert len(computed) <= 4 * 3
    np.testing.assert_allclose(again.vector, without.vector, rtol=1e-6, atol=1e-6)
    other = replace(fit.model, effects=fit.model.effects[:1])
    assert problem.fit(other, None, 1).evidence_over(problem.fit(other, None, 0)) > 0.0


def test_shared_derivatives_that_are_wrong_cost_one_step_at_most(lagging):
    problem, fit = lagging
    without = problem.again(fit, 3)
    derivatives = fit.errors.of_effects_um(fit.vector)
    problem.about(SimpleNamespace(vector=fit.vector, errors=SimpleNamespace(
        of_effects_um=lambda vector: {key: -1e3 * each for key, each in derivatives.items()})))
    assert problem.again(fit, 4).evidence_over(without) > -10.0


@pytest.mark.long
def test_a_model_that_is_right_is_not_replaced_by_a_worse_one(plant, recordings):
    problem = WholeModel(plant, recordings, [0.0] * 3)
    best, tried = sought(problem, plant)
    assert best.evidence_over(tried[0][1]) >= 0.0
    assert not best.model.effects


@pytest.mark.long
def test_a_lag_that_stands_behind_the_hysteresis_is_moved_to_the_front(plant, play):
    stage = replace(plant, effects=(AmplifierLag(LAG_S),))
    parts = steps_and_loops(play, stage)
    behind = replace(plant, dynamics=replace(
        plant.dynamics, time_constant_s=plant.dynamics.time_constant_s + LAG_S))
    problem = WholeModel(behind, parts, [0.0, 0.0])
    best, tried = sought(problem, behind)
    lags_s = [effect.time_constant_s for effect in best.model.effects
              if isinstance(effect, AmplifierLag)]
    residual_um, before_um = (np.std(fit.residual_um[0][0]) for fit in (best, tried[0][1]))
    assert len(lags_s) == 1
    assert residual_um < 1.1 * NOISE_UM < before_um
    assert lags_s[0] == pytest.approx(LAG_S, rel=0.1)


def test_a_mode_in_series_that_an_antiresonance_cancels_is_left_out_with_it(plant, recordings):
    """It is slow enough to hide in the beginning of the fast recordings, which is not fitted."""
    own = plant.dynamics
    hidden = replace(plant, dynamics=ElectricVibrationDynamics(
        own.time_constant_s, (420.0, *own.mode_frequencies_rad_per_s),
        (0.12, *own.damping_ratios), (423.0,), (1e-4,)))
    problem = WholeModel(hidden, recordings, [0.0] * 3)
    fit = problem.fit(hidden, None, 0)
    without = next(each for each in structures(problem, fit)
                   if each.change.startswith("without the mode of 420 rad/s"))
    assert without.model.dynamics == own
    assert is_better(problem.fit(without.model, without.delay_s, 0), fit)


def test_creep_that_is_missing_is_found_without_fast_recordings(plant, play):
    stage = replace(plant, dynamics=ElectricVibrationDynamics(0.0))
    parts = [play(experiments.creep(period_s=60.0), 1, 100.0, stage=stage),
             play(experiments.hysteresis(level_count=6, harmonic_period_s=0.5), 1, 1000.0,
                  stage=stage)]
    slower = replace(stage, creep=CreepDynamics(*(
        rates[:2] for rates in (stage.creep.poles_rad_per_s, stage.creep.zeros_rad_per_s))))
    problem = WholeModel(slower, parts, [0.0, 0.0])
    best, tried = sought(problem, slower)
    frequency_hz = np.geomspace(0.05, 10.0, 50)
    right, wrong = (np.abs(model.response(frequency_hz) / stage.response(frequency_hz) - 1.0)
                    for model in (best.model, tried[1][1].model))
    assert best.model.dynamics.is_static
    assert is_at_noise(problem, best)
    assert right.max() < 1e-3 < 0.1 * wrong.max()


def test_modes_that_velocities_turn_alike_become_modes_in_phase_behind_a_delay(wrong):
    delay_s, truth = 3e-4, (VibrationMode(700.0, 0.02, 0.8), VibrationMode(1700.0, 0.06, -0.2))
    turned = tuple(CoupledMode(
        mode.frequency_rad_per_s, mode.damping_ratio,
        mode.participation * np.cos(mode.frequency_rad_per_s * delay_s),
        -mode.participation * np.sin(mode.frequency_rad_per_s * delay_s)) for mode in truth)
    fit = SimpleNamespace(model=replace(wrong, effects=turned), delay_s=1e-4,
                          weights_of_effects=lambda: np.zeros(2))
    problem = SimpleNamespace(
        sample_period_s=1e-4, longest_s=0.0, fastest_over_noise=lambda fit: 1.0)
    [found] = [each for each in structures(problem, fit) if "in phase" in each.change]
    assert found.delay_s == pytest.approx(1e-4 + delay_s)
    for mode, expected in zip(found.model.effects, truth, strict=True):
        assert type(mode) is VibrationMode
        assert mode.parameters() == pytest.approx(expected.parameters())


def test_an_amplifier_of_second_order_takes_the_place_of_a_lag(plant, play):
    stage = replace(plant, effects=(SecondOrderAmplifier(LAG_S, 0.8),))
    parts = steps_and_loops(play, stage)
    with_lag = replace(plant, effects=(AmplifierLag(LAG_S),))
    problem = WholeModel(with_lag, parts, [0.0, 0.0])
    before = problem.fit(with_lag, None, 6)
    tried = next(each for each in structures(problem, before)
                 if each.change == "its amplifier of second order")
    fit = problem.fit(tried.model, tried.delay_s, 12)
    assert is_better(fit, before)
    [amplifier] = fit.model.effects
    assert amplifier.quality_factor == pytest.approx(0.8, rel=0.1)
    assert np.std(fit.residual_um[0][0]) < 1.1 * NOISE_UM < np.std(before.residual_um[0][0])


def test_a_damped_mode_behind_the_hysteresis_becomes_the_amplifier_in_front_of_it(plant, play):
    rings = ElectricVibrationDynamics(0.0, (4909.0,), (0.082,))
    stage = replace(plant, dynamics=rings, effects=(SecondOrderAmplifier(LAG_S, 0.8),))
    parts = steps_and_loops(play, stage)
    damping = 0.5 / 0.8
    behind = replace(plant, dynamics=ElectricVibrationDynamics(
        0.0, (2.0 * damping / LAG_S, 4909.0), (damping, 0.082)))
    problem = WholeModel(behind, parts, [0.0, 0.0])
    before = problem.fit(behind, None, 6)
    tried = next(each for each in structures(problem, before)
                 if each.change == "its damped mode as an amplifier of second order")
    fit = problem.fit(tried.model, tried.delay_s, 12)
    assert is_better(fit, before)
    [amplifier] = fit.model.effects
    assert amplifier.parameters() == pytest.approx(
        {"time_constant_s": LAG_S, "quality_factor": 0.8}, rel=0.1)


def test_an_overdamped_amplifier_becomes_a_lag_on_each_side_of_the_hysteresis(plant, play):
    front_s, behind_s = 2e-4, 6e-4
    stage = replace(plant, effects=(AmplifierLag(front_s),), dynamics=replace(
        plant.dynamics, time_constant_s=behind_s))
    both_in_front = replace(
        plant, dynamics=replace(plant.dynamics, time_constant_s=0.0), effects=(
            SecondOrderAmplifier(front_s + behind_s,
                                 np.sqrt(front_s * behind_s) / (front_s + behind_s)),))
    recordings = steps_and_loops(play, stage)
    problem = WholeModel(both_in_front, recordings, [0.0] * len(recordings))
    before = problem.fit(both_in_front, None, 8)
    tried = [problem.fit(each.model, each.delay_s, 8) for each in structures(problem, before)
             if each.change.startswith("its amplifier's lag of")]
    assert len(tried) == 2
    best = best_of(tried)
    assert is_better(best, before)
    assert best.model.effects[0].time_constant_s == pytest.approx(front_s, rel=0.1)
    assert best.model.dynamics.time_constant_s == pytest.approx(behind_s, rel=0.1)


def test_two_lags_far_apart_are_tried_as_the_amplifier_next_to_them(plant, play):
    two_lags = replace(plant, dynamics=ElectricVibrationDynamics(
        0.0, (1000.0, 4909.0), (15.0, 0.082)))
    problem = WholeModel(two_lags, steps_and_loops(play, two_lags), [0.0, 0.0])
    tried = next(each for each in structures(problem, problem.fit(two_lags, None, 0))
                 if each.change == "its damped mode as an amplifier of second order")
    assert tried.model.effects[0].quality_factor == pytest.approx(0.05)


@pytest.mark.long
def test_starts_have_the_loops_that_were_estimated_beside_them(plant, wrong, recordings):
    """A line that no prior bends into loops would keep every start from the truth."""
    loops = wrong.hysteresis
    gain = np.ptp(loops.output_range_um) / (loops.voltage_max_v - loops.voltage_min_v)
    line = replace(wrong, hysteresis=replace(
        loops, density_um_per_v2=1e-3 * loops.density_um_per_v2,
        reversible_um_per_v=np.full_like(loops.reversible_um_per_v, gain)))
    problem, again = WholeModel(line, recordings, [0.0] * 3), []

    def with_new_loops(_):
        again.append(problem.with_hysteresis(plant, WIDE_PRIOR))
        return again[0]

    _, tried = begun(problem, line, None, with_new_loops=with_new_loops)
    (_, together), (_, start) = tried[1:3]
    residual_um = [np.std(fit.residual_um[2][0]) for fit in (together, start)]
    assert len(again) == 3  # two with the first start, one with its amplifier of second order
    assert residual_um[1] < 0.2 * residual_um[0]


@pytest.fixture
def cut(plant):
    """A recording without its beginning, so that it depends on its past."""
    ends_v = [0.0, 90.0, 20.0, 50.0, 70.0, 30.0, 80.0, 25.0, 60.0]
    voltage_v = np.concatenate([np.linspace(*pair, 500, endpoint=False)
                                for pair in pairwise(ends_v)])
    displacement_um = plant.simulate(voltage_v, 1e-3)
    return recording_of({"time_s": 1e-3 * np.arange(voltage_v.size - 1500),
                         "voltage_v": voltage_v[1500:],
                         "displacement_um": displacement_um[1500:]})


def test_another_hysteresis_finds_the_past_of_a_recording_anew(plant, cut):
    line = WholeModel(replace(plant, hysteresis=PreisachModel.line(-20.0, 120.0, 1.0)),
                      [cut], [0.0])
    anew, from_the_start = (problem.fit(plant, None, 0).residual_um[0][0] for problem in (
        line.with_hysteresis(plant, WIDE_PRIOR), WholeModel(plant, [cut], [0.0])))
    np.testing.assert_allclose(anew, from_the_start, atol=1e-9)
    assert np.std(anew) < 1e-3 * np.ptp(cut.displacement_um)


def test_a_past_that_is_found_is_not_taken_if_the_one_before_is_closer(plant, cut, monkeypatch):
    problem = WholeModel(plant, [cut], [0.0])
    before = problem.fit(plant, None, 0).residual_um[0][0]
    monkeypatch.setattr("piezo_identification.simulation.past_search.starting_past_v",
                        lambda *_: (50.0, 45.0))
    wrong, kept = (each.fit(plant, None, 0).residual_um[0][0] for each in (
        WholeModel(plant, [cut], [0.0]), problem.with_hysteresis(plant, WIDE_PRIOR)))
    assert np.std(wrong) > 3.0 * np.std(before)
    np.testing.assert_allclose(kept, before, atol=1e-9)


def test_numbers_that_cannot_be_simulated_are_worse_than_all_others(
        plant, recordings, monkeypatch):
    model = replace(plant, effects=(SecondOrderAmplifier(1e-4), ))
    fit = WholeModel(model, recordings, [0.0] * 3).fit(model, None, 0)

    def fail(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    assert np.isfinite(fit.errors.value(fit.vector))
    fit.errors.forget()
    for name in "apply", "advance":
        monkeypatch.setattr(SecondOrderAmplifier, name, fail)
    assert fit.errors.value(fit.vector) == np.inf


class FitOfEvidence(SimpleNamespace):
    counts = np.full(3, 1000.0)

    def evidence_over(self, other):
        return self.evidence - other.evidence

    def held_out_over(self, other):
        return 0.0


def problem_to_begin(fit, over_noise):
    return SimpleNamespace(sample_period_s=1e-4, is_sampled=True, responses=(), fit=fit,
                           over_noise=lambda fit: np.array([over_noise]),
                           fastest_over_noise=lambda fit: over_noise)


@pytest.mark.parametrize("behind, order", [
    (50.0, [True, False]), (200.0, [False, True]), (5000.0, [False]), (-200.0, [True, False])])
def test_the_amplifier_that_a_search_cannot_find_comes_first_if_it_is_alike(
        wrong, behind, order):
    """The search makes it simpler, but finds none once the fast rows are explained."""
    def fit(model, delay_s, steps, changes=None):
        kinds = [type(effect) for effect in model.effects]
        evidence = {SecondOrderAmplifier: 1e4 - behind, AmplifierLag: 1e4}
        return FitOfEvidence(model=model, delay_s=delay_s, numbers=1,
                             evidence=max([evidence.get(kind, 0.0) for kind in kinds] or [0.0]))

    problem = problem_to_begin(fit, 2.0)
    found, _ = begun(problem, wrong, None, with_new_loops=lambda start: problem)
    assert [has_amplifier(fit) for fit in promising([fit for _, fit in found])] == order


@pytest.mark.parametrize("over_noise, are_tried", [(1.005, False), (1.03, True)])
def test_other_starts_are_tried_unless_all_is_surely_noise(wrong, over_noise, are_tried):
    def fit(model, delay_s, steps, changes=None):
        return FitOfEvidence(model=model, delay_s=delay_s, numbers=1, evidence=0.0)

    problem = problem_to_begin(fit, over_noise)
    _, tried = begun(problem, wrong, None, with_new_loops=lambda start: problem)
    assert (len(tried) > 2) == are_tried


@pytest.mark.parametrize("behind, is_continued", [(50.0, True), (5000.0, False)])
def test_a_structure_that_one_step_leaves_far_behind_gets_no_other(wrong, behind, is_continued):
    best = FitOfEvidence(model=wrong, delay_s=None, numbers=1, evidence=0.0, has_converged=True,
                         density_changes=None, weights_of_effects=lambda: np.zeros(0))
    begun_with, continued = [], []

    def fit(model, delay_s, steps, changes=None):
        begun_with.append(steps)
        return FitOfEvidence(model=model, delay_s=delay_s, numbers=1, evidence=-behind,
                             has_converged=False, gain=1.0)

    def again(fit, steps):
        if fit is not best:
            continued.append(fit)
        return fit

    searched(SimpleNamespace(sample_period_s=1e-4, longest_s=0.0, fit=fit, again=again,
                             about_here=lambda: None, about=lambda fit: None,
                             over_noise=lambda fit: np.array([1.0]),
                             fastest_over_noise=lambda fit: 1.0), best)
    assert begun_with and set(begun_with) == {1}
    assert bool(continued) == is_continued


@pytest.mark.parametrize("over_noise, numbers, gain, ends", [
    (1.0, 2, 14.0, True), (1.0, 2, 16.0, False), (1.0, 0, 1.0, False),
    (5.0, 2, 29.0, True), (5.0, 0, 29.0, True), (5.0, 2, 31.0, False)])
def test_a_search_ends_when_a_change_reduces_the_residuals_only_little(
        over_noise, numbers, gain, ends):
    """By 0.5 % near the noise, unless the model became simpler, and by 1 % farther above it."""
    problem = SimpleNamespace(over_noise=lambda fit: np.array([over_noise]))
    before, best = (FitOfEvidence(numbers=number, evidence=evidence)
                    for number, evidence in ((1, 0.0), (numbers, gain)))
    assert is_pointless(problem, before, best) == ends


@pytest.mark.parametrize("relaxation_v, why", [
    (8.0, None), (3.0, "the stage would go back while the voltage goes on")])
def test_a_hysteresis_that_would_move_the_stage_back_is_not_possible(
        wrong, recordings, relaxation_v, why):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    loops = BoucWenHysteresis(2.0, relaxation_v)
    assert problem.why_impossible(SimpleNamespace(
        model=replace(wrong, effects=(loops,)))) == why


@pytest.mark.parametrize("gain, numbers, is_moved", [
    (0.5, 1, False), (2.0, 1, True), (0.5, 0, True)])
def test_a_lag_stays_where_it_is_if_the_recordings_do_not_tell_the_places_apart(
        wrong, gain, numbers, is_moved):
    def fit(model, delay_s, steps, changes=None):
        ahead = any(type(effect) is AmplifierLag for effect in model.effects)
        is_whole_lag = ahead and model.dynamics.time_constant_s == 0.0
        return FitOfEvidence(model=model, delay_s=delay_s, numbers=numbers, has_converged=True,
                             evidence=gain if is_whole_lag else -1e4, gain=0.0,
                             density_changes=None,
                             weights_of_effects=lambda: np.zeros(len(model.effects)))

    problem = SimpleNamespace(sample_period_s=1e-4, longest_s=0.0, fit=fit,
                              again=lambda fit, steps: fit, about_here=lambda: None,
                              about=lambda fit: None, responses=(),
                              over_noise=lambda fit: np.array([1.0]),
                              fastest_over_noise=lambda fit: 1.0)
    before = FitOfEvidence(model=wrong, delay_s=None, numbers=1, evidence=0.0, has_converged=True,
                           density_changes=None, weights_of_effects=lambda: np.zeros(0))
    best, _ = searched(problem, before)
    assert (best is not before) == is_moved


@pytest.mark.parametrize("zeros, continued", [
    ((0.11, 1.1), True), ((0.11, 0.99), False), ((0.099, 1.1), True)])
def test_a_start_continues_the_creep_unless_its_last_pair_has_the_other_sign(
        wrong, recordings, zeros, continued):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    given = replace(wrong, creep=CreepDynamics((0.1, 1.0), zeros),
                    effects=(VibrationMode(2800.0, 0.02, 0.8),))
    for structure in starts(problem, given, None, True):
        creep = structure.model.creep
        assert creep.zeros_rad_per_s[:2] == pytest.approx(zeros)
        assert (len(creep.zeros_rad_per_s) > 2) == continued


def test_modes_that_overlap_are_merged_within_the_limits_of_a_mode(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    given = replace(wrong, dynamics=ElectricVibrationDynamics(1e-4), effects=(
        VibrationMode(2800.0, 0.02, 2.5), VibrationMode(2810.0, 0.02, 0.6)))
    merged = next(starts(problem, given, None, True)).model.effects
    assert [mode.participation for mode in merged if isinstance(mode, VibrationMode)] == [3.0]


def test_an_amplifier_of_second_order_stands_beside_the_modes_that_ring_and_move_the_stage(wrong):
    modes = (VibrationMode(900.0, 0.4, -0.02), VibrationMode(2800.0, 0.02, 0.8),
             VibrationMode(3000.0, 0.01, -0.004), VibrationMode(4900.0, 0.03, 0.1))

    def fit(model, delay_s, steps, changes=None):
        return FitOfEvidence(model=model, delay_s=delay_s, numbers=1, evidence=0.0,
                             density_changes=None)

    _, tried = begun(problem_to_begin(fit, 2.0), replace(wrong, effects=modes), 1e-5,
                     with_new_loops=lambda start: problem_to_begin(fit, 2.0))
    beside = [[effect.frequency_rad_per_s for effect in fit.model.effects
               if isinstance(effect, VibrationMode)] for _, fit in tried if has_amplifier(fit)]
    assert beside == [[2800.0, 4900.0], [2800.0, 4900.0]]  # without and with a delay
    [amplifier] = {effect for _, fit in tried for effect in fit.model.effects
                   if isinstance(effect, SecondOrderAmplifier)}
    assert amplifier.time_constant_s == pytest.approx(1e-4 + 1e-5)  # of the lag and the delay
    assert amplifier.quality_factor == FLAT


def test_rows_that_are_read_late_within_their_hold_are_found(plant, play):
    """A logger at half the clock reads each row at an instant of its own, 0.5 periods late."""
    whole = play(experiments.dynamics(duration_s=0.2), 1)
    held = np.repeat(whole.voltage_v[::2], 2)[: whole.voltage_v.size]
    measured_um = plant.simulate(held, 1.0 / 40_000.0)
    noise = np.random.default_rng(5).normal(size=measured_um.size)
    late = replace(
        whole.select(np.arange(whole.voltage_v.size) % 2 == 0),
        sample_rate_hz=20_000.0, sample_index=np.arange(measured_um[1::2].size),
        sample_periods_s=np.full(measured_um[1::2].size, 5e-5), voltage_v=held[::2],
        displacement_um=measured_um[1::2] + NOISE_UM * noise[1::2])
    fit = WholeModel(plant, [late], [0.0]).fit(plant, 0.0, 6)
    assert fit.delay_s == pytest.approx(-2.5e-5, abs=2e-6)


def test_a_fit_to_all_rows_holds_nothing_out_and_leaves_less_of_them(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    chosen = problem.fit(wrong, None, 3)
    with_all = problem.with_held_out_rows(chosen)
    before, after = (with_all.fit(chosen.model, None, steps) for steps in (0, 3))
    for part, whole in zip(chosen.residual_um, before.residual_um, strict=True):
        np.testing.assert_allclose(  # the offset is one of all rows already
            np.sort(whole[0]), np.sort(np.concatenate(part)), atol=1e-9)
        assert not whole[1].size
    assert after.numbers == before.numbers and after.evidence_over(before) > 0.0


def test_three_fits_are_in_one_order_whichever_two_are_compared(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    first = problem.fit(wrong, None, 0)
    second, third = (problem.fit(wrong, None, steps) for steps in (1, 3))
    assert third.evidence_over(first) == pytest.approx(
        third.evidence_over(second) + second.evidence_over(first))


def test_a_pair_of_the_creep_may_have_another_sign_than_that_which_was_given(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    poles = wrong.creep.poles_rad_per_s
    turned = CreepDynamics(poles, (*wrong.creep.zeros_rad_per_s[:-1], 0.99 * poles[-1]))
    fit = problem.fit(replace(wrong, creep=turned), None, 2)
    assert np.isfinite(fit.evidence_over(problem.fit(wrong, None, 0)))
    assert fit.model.creep.zeros_rad_per_s[-1] < fit.model.creep.poles_rad_per_s[-1]


def test_what_a_fit_simulated_is_made_anew_where_it_is_asked_for(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    fit = problem.fit(wrong, None, 1)
    evidence, deviations = problem.evidence(fit), fit.deviations()
    fit.errors.forget()
    assert fit.deviations() == deviations
    for one, other in zip(evidence, problem.evidence(fit), strict=True):
        np.testing.assert_allclose(one.residual_um, other.residual_um, atol=1e-12)


def test_modes_between_which_are_antiresonances_stand_in_parallel_in_every_start(wrong, recordings):
    problem = WholeModel(wrong, recordings, [0.0] * 3)
    in_series = ElectricVibrationDynamics(1e-4, (2800.0, 4900.0), (0.05, 0.03), (3500.0,), (0.04,))
    listed = list(starts(problem, replace(wrong, dynamics=in_series), None, True))
    others = [each for each in listed if "loudest" not in each.change]
    loudest, = (each for each in listed if each not in others)
    (mode,) = (effect for effect in loudest.model.effects if isinstance(effect, VibrationMode))
    assert mode.frequency_rad_per_s == pytest.approx(4900.0, rel=0.01) and others
    for structure in others:
        assert not structure.model.dynamics.mode_frequencies_rad_per_s
        assert [effect.frequency_rad_per_s for effect in structure.model.effects
                if isinstance(effect, VibrationMode)] == [2800.0, 4900.0]


def test_slower_creep_is_tried_only_if_the_recordings_last_longer(plant):
    def names(longest_s):
        fit = SimpleNamespace(model=plant, delay_s=None, weights_of_effects=lambda: np.zeros(0))
        problem = SimpleNamespace(sample_period_s=1e-4, longest_s=longest_s, responses=(),
                                  fastest_over_noise=lambda fit: 1.0)
        return {each.change: each.model for each in structures(problem, fit)}

    slowest_s = 1.0 / plant.creep.poles_rad_per_s[0]
    assert "with slower creep" not in names(2.0 * slowest_s)
    slower = names(100.0 * slowest_s)["with slower creep"].creep
    assert slower.poles_rad_per_s[1:] == plant.creep.poles_rad_per_s
    assert slower.poles_rad_per_s[0] == pytest.approx(plant.creep.poles_rad_per_s[0] / 8.0)


def test_of_two_equal_pairs_of_opposite_signs_the_sum_remains(plant):
    creep = CreepDynamics((0.1, 2.0, 2.001), (0.101, 2.0 * np.exp(0.04), 2.001 * np.exp(-0.03)))
    fit = SimpleNamespace(model=replace(plant, creep=creep), delay_s=None,
                          weights_of_effects=lambda: np.zeros(0))
    problem = SimpleNamespace(sample_period_s=1e-4, longest_s=0.0, responses=(),
                              fastest_over_noise=lambda fit: 1.0)
    [simpler] = [each for each in structures(problem, fit) if "without the creep" in each.change]
    assert simpler.model.creep.poles_rad_per_s == (0.1, 2.0)
    assert simpler.model.creep.zeros_rad_per_s == pytest.approx((0.101, 2.0 * np.exp(0.01)))


def test_creep_that_the_separate_steps_did_not_find_is_added(plant, recordings):
    problem = WholeModel(replace(plant, creep=CreepDynamics()), recordings, [0.0] * 3)
    before = problem.fit(problem.given, None, 2)
    [added] = [each for each in structures(problem, before) if each.change == "with creep"]
    fit = problem.fit(added.model, added.delay_s, 8, before.density_changes)
    assert is_better(fit, before)
