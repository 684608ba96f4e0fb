# SPDX-License-Identifier: BSD-3-Clause
"""A request to track is prepared, and whatever its plan is, one loop plays it to its end."""

import dataclasses

import numpy as np
import pytest

from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.references.live_reference import LiveReference
from piezo_controller.references.reference import Reference, trajectory
from piezo_controller.tracking.feedbacks import Feedbacks, FeedbackSettings
from piezo_controller.tracking.track import TrackRequest, prepare
from piezo_controller.tracking.tracking_modes import StageClock

STAGE = StageClock()
HARMONIC = Reference("harmonic", (100.0,), (10.0,), (), 50.0)
RANDOM = Reference("random", (200.0,), (10.0,), (), 50.0, seed=1)


RANDOM_LIVE = Reference("random", (100.0,), (10.0,), (), 50.0, seed=2)
LIVE = Reference("topic", (100.0,), (10.0,))


class Heard:
    """Writes down what it is told of the preparation."""

    def __init__(self):
        self.steps = []

    def begin(self, step):
        self.steps.append(step)

    def watch(self, fraction):
        assert 0.0 <= fraction <= 1.0


@pytest.fixture
def request_of(model_path, tmp_path):
    def make(mode, *references, **changes):
        return TrackRequest(mode, str(model_path), "0" * 64, references, [0.1] * len(references),
                            directory=str(tmp_path), **changes)

    return make


def prepared_for(request, settings=None, heard=None):
    return prepare(request, STAGE, Feedbacks(settings or FeedbackSettings(), STAGE),
                   heard or Heard())


def voltages(plan):
    """Yield the voltages of a plan, tick by tick, by nothing but what every plan has."""
    more, loaded_v = plan.continuation(), plan.once_voltage_v
    assert (more is not None) == plan.streamed == (not plan.period_voltage_v.size)
    more = more or (lambda: plan.period_voltage_v)
    while True:
        while loaded_v.size < STAGE.samples_per_tick:
            further_v = more()
            assert further_v is not None and further_v.size
            loaded_v = np.r_[loaded_v, further_v]
        yield loaded_v[:STAGE.samples_per_tick]
        loaded_v = loaded_v[STAGE.samples_per_tick:]


def play(prepared, exchange):
    """Close the loop around a stage; the answer to a tick acts after the next."""
    answers_v, ticks = [0.0, 0.0], 0
    for voltage_v in voltages(prepared.plan):
        answers_v.append(prepared.take(exchange(voltage_v + answers_v.pop(0))))
        ticks += 1
        if prepared.over or ticks == prepared.ticks(STAGE.samples_per_tick):
            return


@pytest.mark.parametrize(("mode", "references", "changes"), [
    ("open_loop", [HARMONIC], {}),
    ("feedforward", [HARMONIC], {}),
    ("feedforward", [HARMONIC], {"inversion": "least_squares"}),
    ("feedforward", [RANDOM], {}),
    ("feedforward", [HARMONIC, RANDOM], {}),
    ("learning", [HARMONIC], {"iterations": 2}),
])
def test_every_plan_is_played_to_its_end_by_the_same_loop(
        request_of, exchange_with, stage_model, mode, references, changes):
    heard = Heard()
    prepared = prepared_for(request_of(mode, *references, **changes), heard=heard)
    assert heard.steps == ["plan"]
    assert prepared.plan.uncompensated == ()
    assert prepared.plan.iteration == 0
    play(prepared, exchange_with(stage_model))
    assert prepared.run.complete
    assert prepared.run.e_rms_percent() < (40.0 if mode == "open_loop" else 1.0)


def test_what_was_learned_is_kept_and_taken_up_again(
        request_of, exchange_with, stage_model, tmp_path):
    request = request_of("learning", HARMONIC, iterations=2)
    prepared = prepared_for(request)
    learning = prepared.learning
    assert not learning.path.exists() and learning.path.parent == tmp_path
    play(prepared, exchange_with(stage_model))
    learning.keep()
    assert learning.account.startswith(f"learning ended after {learning.learner.iterations} ")
    again = prepared_for(request)
    np.testing.assert_allclose(again.learning.learner.correction_um, learning.learner.best_um,
                               atol=1e-9)
    other = dataclasses.replace(request, model_sha256="1" * 64, learned=str(learning.path))
    with pytest.raises(ValueError, match="learned with another model_sha256"):
        prepared_for(other)


def test_learning_begins_from_a_like_reference_with_a_smaller_error(
        request_of, exchange_with, stage_model, tmp_path):
    hysteresis = stage_model.hysteresis
    stage = dataclasses.replace(stage_model, hysteresis=dataclasses.replace(
        hysteresis, density_um_per_v2=1.05 * hysteresis.density_um_per_v2))
    larger = dataclasses.replace(HARMONIC, amplitude_um=(12.0,))

    def first_error_um(reference):
        prepared = prepared_for(request_of("learning", reference, iterations=1))
        begun_um = prepared.learning.learner.correction_um
        play(prepared, exchange_with(stage))
        return prepared.learning, begun_um, prepared.learning.learner.best_rms_um

    cold, begun_um, cold_um = first_error_um(larger)
    assert not begun_um.any() and "like" not in cold.account
    prepared = prepared_for(request_of("learning", HARMONIC, iterations=4))
    play(prepared, exchange_with(stage))
    prepared.learning.keep()
    warm, begun_um, warm_um = first_error_um(larger)
    np.testing.assert_allclose(begun_um, 1.2 * prepared.learning.learner.best_um, atol=1e-9)
    assert prepared.learning.path.name in warm.account
    assert warm_um < 0.5 * cold_um


def test_feedback_is_a_step_of_its_own_and_a_design_is_made_once(request_of, monkeypatch):
    designed = []
    monkeypatch.setattr(
        "piezo_controller.tracking.feedbacks.design_feedback",
        lambda *given, **options: designed.append((given[-1], *options.values())) or _integrator())
    feedbacks, heard = Feedbacks(FeedbackSettings(), STAGE), Heard()
    for mode in ("composite", "pi", "composite", "composite_single_rate"):
        prepared = prepare(request_of(mode, HARMONIC), STAGE, feedbacks, heard)
        # The stage evaluates it.
        assert prepared.feedback is None and prepared.law is not None
    assert heard.steps == ["plan", "design the feedback"] * 4
    assert designed == [("h_infinity", 0), ("pi", 1)]


@pytest.mark.parametrize(("change", "message"), [
    ({"durations_s": [0.0]}, "duration_s is 0: give more than 0"),
    ({"durations_s": [float("nan")]}, "duration_s is nan"),
    ({"tolerance_um": -1.0}, "tolerance_um is -1: give a positive number"),
    ({"mode": "learning", "inversion": "zero_phase"}, "leave then and inversion empty"),
    ({"mode": "learnt"}, "unknown mode 'learnt'"),
    ({"references": [LIVE]}, "a published reference is followed alone, in the modes feedforward"),
    ({"mode": "pi", "references": [RANDOM]}, "pi plays one reference that has a period"),
])
def test_request_without_meaning_is_refused_in_one_sentence(request_of, change, message):
    request = dataclasses.replace(request_of("feedforward", HARMONIC), **change)
    with pytest.raises(ValueError, match=message) as refusal:
        prepared_for(request)
    assert "\n" not in str(refusal.value)


def test_streamed_reference_takes_its_feedback_behind_the_inverse(request_of, monkeypatch):
    monkeypatch.setattr("piezo_controller.tracking.feedbacks.design_feedback",
                        lambda *given, **options: _integrator())
    prepared = prepared_for(
        request_of("composite", RANDOM), FeedbackSettings(place="before_inverse"))
    assert isinstance(prepared.feedback, MultirateFeedback) and prepared.law is None


@pytest.mark.long
def test_controller_for_no_computing_time_answers_no_blocks(request_of, stage_model, tmp_path):
    path = tmp_path / "quick.json"
    save_controller(path, design_feedback(stage_model, load_weights(), delay_ticks=0))
    request = request_of("composite", HARMONIC)
    prepared = prepared_for(request, FeedbackSettings(controller_file=str(path)))
    assert prepared.law.delay_ticks == 0 and prepared.law.inverse is not None
    for settings, references in ((FeedbackSettings(controller_file=str(path), loop="remote"),
                                  HARMONIC), (FeedbackSettings(controller_file=str(path)), RANDOM)):
        with pytest.raises(ValueError, match="quick.json: is designed for 0 ticks of computing"):
            prepared_for(request_of("composite", references), settings)


def test_controller_whose_gain_nobody_tells_passes_the_inverse_by_that_of_the_model(
        request_of, stage_model, controller, tmp_path):
    path = tmp_path / "plain.json"
    save_controller(path, dataclasses.replace(controller, report={}))
    prepared = prepared_for(request_of("composite", HARMONIC),
                            FeedbackSettings(controller_file=str(path)))
    assert prepared.law.inverse.gain_um_per_v == pytest.approx(
        controller.report["hysteresis_gain_um_per_v"])
    assert prepared.law.delay_ticks == 1


def test_controller_of_a_goal_goes_before_that_of_the_node_and_has_a_mode_to_act_in(
        request_of, controller, tmp_path):
    path = tmp_path / "named.json"
    save_controller(path, controller)
    feedbacks = Feedbacks(FeedbackSettings(controller_file=str(tmp_path / "absent.json")), STAGE)
    assert feedbacks.with_controller("", "composite") is feedbacks
    for mode in "composite", "composite_single_rate":
        prepared = prepare(request_of(mode, HARMONIC), STAGE,
                           feedbacks.with_controller(str(path), mode), Heard())
        assert prepared.law.delay_ticks == controller.delay_ticks
    for mode in "pid", "feedforward", "learning":
        with pytest.raises(ValueError, match=f"nothing to act on in the mode '{mode}': leave it"):
            feedbacks.with_controller(str(path), mode)


@pytest.mark.parametrize(("mode", "references"), [
    ("learning", [LIVE]), ("pid", [LIVE]), ("feedforward", [LIVE, HARMONIC]),
    ("feedforward", [HARMONIC, LIVE]), ("feedforward", [Reference("topic")])])
def test_published_reference_is_refused_where_it_cannot_be_followed(request_of, mode, references):
    live = LiveReference(STAGE.sample_period_s)
    live.take(0, 0.0, 0, [50.0])
    with pytest.raises(ValueError, match=r"followed alone|give one of each per component"):
        prepare(request_of(mode, *references), STAGE, Feedbacks(FeedbackSettings(), STAGE),
                Heard(), live=live)


def test_published_reference_is_answered_behind_the_inverse_to_its_end(
        request_of, exchange_with, stage_model, monkeypatch):
    monkeypatch.setattr("piezo_controller.tracking.feedbacks.design_feedback",
                        lambda *given, **options: _integrator())
    live = LiveReference(STAGE.sample_period_s)
    live.take(0, 0.0, 20, [50.0])
    prepared = prepare(request_of("composite", LIVE), STAGE, Feedbacks(FeedbackSettings(), STAGE),
                       Heard(), live=live)
    assert isinstance(prepared.feedback, MultirateFeedback) and prepared.law is None
    wanted_um = trajectory(RANDOM_LIVE).sample(0, 40_000)
    exchange, sent = exchange_with(stage_model), [1]

    def publish_and_exchange(voltage_v):
        live.take(sent[0], 0.0, 20, wanted_um[sent[0]:sent[0] + 40])
        sent[0] += 40
        return exchange(voltage_v)

    play(prepared, publish_and_exchange)
    assert prepared.run.complete
    assert prepared.run.e_rms_percent() < 1.0
    assert "followed the reference" in prepared.plan.note


def _integrator():
    return FeedbackController(np.eye(1), np.full((1, 1), 0.1), np.eye(1), np.zeros((1, 1)), 1e-3,
                              {"hysteresis_gain_um_per_v": 1.0}, {})
