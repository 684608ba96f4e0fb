# SPDX-License-Identifier: BSD-3-Clause
"""The feedback that each mode of tracking adds, designed for the model or read from a file."""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.controller_file import (
    ControllerFileError,
    load_stabilising_controller,
)
from piezo_controller.feedback.design_choices import DEFAULT_WEIGHTS
from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    check_stabilises,
    design_feedback,
)
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.onboard_law import answers_samples, onboard_law
from piezo_controller.feedback.synthesis.generalised_plant import hysteresis_gain_range
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.learning.fast_sensitivity import fast_sensitivity
from piezo_controller.tracking.foreseen import Sensitivity, open_loop_sensitivity
from piezo_controller.tracking.plan import TrackingPlan
from piezo_controller.tracking.tracking_modes import FEEDBACK_METHODS, StageClock, feedback_room_v
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.feedback_law import FeedbackLaw

PLACES = ("before_inverse", "behind_inverse")
LOOPS = ("onboard", "remote")


class Feedback(Protocol):
    """What answers the blocks of a run."""

    def step(self, expected_um: FloatArray,
             displacement_um: FloatArray) -> float:
        """Return the voltage (V) that answers the block of one tick."""


@dataclass(frozen=True)
class FeedbackSettings:
    """Which feedback the modes take.

    Attributes
    ----------
    max_feedback_v : float
        Largest voltage of a feedback beside a feedforward, of either sign (V); the stage's own
        limit holds where that is less.
    weights : str
        Weights of the design: a file, a name of those that come with the package, or empty.
    controller_file : str
        Controller of the composite modes; empty to design it for the model.
    place : str
        Of `PLACES`: where the feedback of the composite modes enters. That of a streamed
        feedforward is always behind the inverse.
    loop : str
        Of `LOOPS`: ``onboard`` where the stage evaluates the feedback by itself, ``remote`` where
        it is answered block by block. A streamed or learned feedforward takes the latter.
    max_error_um : float
        Of a law on board, see `FeedbackLaw`; PID and PI have none, as all of the travel is theirs.
    """

    max_feedback_v: float = 20.0
    weights: str = ""
    controller_file: str = ""
    place: str = PLACES[0]
    loop: str = LOOPS[0]
    max_error_um: float = 4.0


class Feedbacks:
    """Makes the feedback of a run; a design for the same model is made once."""

    def __init__(self, settings: FeedbackSettings, stage: StageClock) -> None:
        self._settings, self._stage = settings, stage
        self._max_feedback_v = min(settings.max_feedback_v, stage.max_feedback_v)
        self._designs: dict[tuple[str, str, int], FeedbackController] = {}

    def of_mode(self, mode: str, model: StageModel, model_sha256: str,
                plan: TrackingPlan) -> Feedback:
        """Make the feedback of a mode of `FEEDBACK_METHODS`.

        Parameters
        ----------
        model_sha256 : str
            Hash of the model's file.
        plan : TrackingPlan
            What is played beside it.

        Raises
        ------
        ValueError
            If the file, the weights or the design are unusable.
        """
        settings, stage = self._settings, self._stage
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        controller = self._controller(mode, model, model_sha256, answered=True)
        if not composite:
            return MultirateFeedback(controller, self._room_v(plan))
        if settings.place == "behind_inverse" or not isinstance(plan, FeedforwardPlan):
            return self.limited(controller)
        return FeedbackBeforeInverse(
            controller, model, plan, stage.samples_per_tick, self._max_feedback_v,
            stage.rest_voltage_v)

    def law_of_mode(self, mode: str, model: StageModel, model_sha256: str,
                    plan: TrackingPlan) -> FeedbackLaw | None:
        """Make the feedback of a mode for the stage to evaluate; see `of_mode`.

        Returns
        -------
        FeedbackLaw or None
            None where the feedback is to be answered block by block.
        """
        if self._settings.loop != "onboard" or not isinstance(plan, FeedforwardPlan):
            return None
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        return onboard_law(
            self._controller(mode, model, model_sha256, answered=False), model, plan,
            self._stage.sample_period_s,
            self._max_feedback_v if composite else self._room_v(plan),
            before_inverse=composite and self._settings.place == "before_inverse",
            max_error_um=self._settings.max_error_um if composite else math.inf)

    def sensitivity(self, mode: str, model: StageModel, model_sha256: str) -> Sensitivity:
        """Return what a mode without an inverse leaves of a reference, over frequency.

        Parameters
        ----------
        mode : str
            ``open_loop``, ``pid`` or ``pi``.
        model_sha256 : str
            Hash of the model's file.
        """
        stage = self._stage
        if mode not in FEEDBACK_METHODS:
            return open_loop_sensitivity(model, stage.sample_period_s)
        controller = self._controller(mode, model, model_sha256, answered=True)

        def left(frequency_hz: FloatArray) -> ComplexArray:
            within = frequency_hz < 0.5 / stage.tick_s  # above, the ticks show an image of it
            left = np.ones(frequency_hz.size, dtype=complex)
            left[within] = fast_sensitivity(
                model, controller, frequency_hz[within], stage.sample_period_s)
            return left

        return left

    def check_model(self, model: StageModel, model_sha256: str, present: StageModel) -> None:
        """Refuse a model whose composite feedback is unstable with it, or with the present one.

        A stage that has changed lies near both. The design is kept for the next run.

        Parameters
        ----------
        model_sha256 : str
            Hash of the model's file.
        present : StageModel
            That the model is to replace.

        Raises
        ------
        ValueError
        """
        controller = self._controller(
            "composite", model, model_sha256, answered=self._settings.loop != "onboard")
        for name, other in (("it", model), ("the model that it replaces", present)):
            try:
                check_stabilises(controller, other, self._stage.sample_period_s)
            except UnstableLoop as reason:
                raise ValueError(f"the feedback for the extended model is unstable with {name}: "
                                 f"{reason}") from None

    def _room_v(self, plan: TrackingPlan) -> float:
        """Return what a feedback may give that has all of the travel as its work (V)."""
        stage = self._stage
        return min(feedback_room_v(plan, stage.voltage_range_v), stage.max_feedback_v)

    def _controller(self, mode: str, model: StageModel, model_sha256: str,
                    answered: bool) -> FeedbackController:
        """Read or design the controller of a mode, for a loop that is answered or not."""
        stage, method = self._stage, FEEDBACK_METHODS[mode]
        if method != "h_infinity" or not self._settings.controller_file:
            delay_ticks = 0 if method == "h_infinity" and not answered else 1
            return self._design(method, model, model_sha256, delay_ticks)
        controller = load_stabilising_controller(
            self._settings.controller_file, model, stage.tick_s, stage.sample_period_s)
        if answered and stage.samples_per_tick > 1 and answers_samples(
                controller, stage.sample_period_s):
            raise ControllerFileError(
                f"{self._settings.controller_file}: answers every sample, which the stage has to "
                "do by itself; set feedback to onboard, and track a reference that is neither "
                "streamed nor published")
        if answered and controller.delay_ticks != 1:
            raise ControllerFileError(
                f"{self._settings.controller_file}: is designed for {controller.delay_ticks} ticks "
                "of computing time, but answers take 1; set feedback to onboard, or design it "
                "with --delay-ticks 1")
        if "hysteresis_gain_um_per_v" not in controller.report:
            # Of another tool: it stabilises the model, at this gain too.
            nominal = float(np.mean(hysteresis_gain_range(model)))
            controller = replace(controller, report={
                **controller.report, "hysteresis_gain_um_per_v": nominal})
        return controller

    def with_controller(self, path: str, mode: str) -> "Feedbacks":
        """Return what makes the same feedbacks, but takes that of the composite modes from a file.

        Parameters
        ----------
        path : str
            Controller file; with an empty one nothing changes.
        mode : str
            That the file is meant for.

        Raises
        ------
        ValueError
            If the feedback of the mode comes from no file.
        """
        if not path:
            return self
        if FEEDBACK_METHODS.get(mode) != "h_infinity":
            raise ValueError(f"a controller file has nothing to act on in the mode {mode!r}: "
                             "leave it out, or use composite")
        return Feedbacks(replace(self._settings, controller_file=path), self._stage)

    def limited(self, controller: FeedbackController) -> Feedback:
        """Run a controller behind the inverse, within the largest voltage of a feedback."""
        return MultirateFeedback(controller, self._max_feedback_v)

    def _design(self, method: str, model: StageModel, model_sha256: str,
                delay_ticks: int) -> FeedbackController:
        key = model_sha256, method, delay_ticks
        if key not in self._designs:
            weights = load_weights(
                self._settings.weights or DEFAULT_WEIGHTS).at_tick(self._stage.tick_s)
            self._designs[key] = design_feedback(
                model, weights, self._stage.sample_period_s, model_sha256, method,
                delay_ticks=delay_ticks)
        return self._designs[key]
