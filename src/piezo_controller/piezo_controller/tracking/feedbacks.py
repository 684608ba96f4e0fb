# SPDX-License-Identifier: BSD-3-Clause
"""The feedback of each mode of tracking, designed for the model or read from a file."""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.axes_design import design_axes_feedback
from piezo_controller.feedback.controller_file import (
    ControllerFileError,
    load_stabilising_controller,
)
from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    check_stabilises,
    design_feedback,
)
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.onboard_law import answers_samples, onboard_law
from piezo_controller.feedback.synthesis.design_choices import DEFAULT_WEIGHTS
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_controller.feedback.synthesis.weights import DesignWeights, load_weights
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.learning.slow_feedback import fast_sensitivity
from piezo_controller.tracking.foreseen import Sensitivity, open_loop_sensitivity
from piezo_controller.tracking.tracking_modes import FEEDBACK_METHODS, StageClock, feedback_room_v
from piezo_models.axes.coupled import CoupledModel
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.axes_law import AxesLaw, load_axes_law
from piezo_models.feedback_law.feedback_law import FeedbackLaw

PLACES = ("before_inverse", "behind_inverse")
LOOPS = ("onboard", "remote")


class Feedback(Protocol):
    """Interface of what answers the blocks of a run."""

    def step(self, expected_um: FloatArray,
             displacement_um: FloatArray) -> float:
        """Return the voltage (V) that answers the block of one tick."""


@dataclass(frozen=True)
class FeedbackSettings:
    """Which feedback the modes use."""

    max_feedback_v: float = 20.0
    """Largest voltage of a feedback that acts together with a feedforward, of either sign (V); the
    stage's own limit applies where it is lower."""
    weights: str = ""
    """Weights of the design: a file, the name of weights of the package, or empty for the
    default."""
    controller_file: str = ""
    """File of the controller of the composite modes; empty to design it for the model."""
    place: str = PLACES[0]
    """One of `PLACES`: where the feedback of the composite modes enters. With a streamed
    feedforward it is always behind the inverse."""
    loop: str = LOOPS[0]
    """One of `LOOPS`: ``onboard`` where the stage evaluates the feedback by itself, ``remote``
    where it is answered block by block. A streamed or learned feedforward requires ``remote``."""
    max_error_um: float = 4.0
    """Largest error for a law on board, see `FeedbackLaw`. PID and PI have no such limit, as they
    must provide the whole travel."""


class Feedbacks:
    """Makes the feedback of a run; designs are cached by model.

    Feedback together with a feedforward has at most `max_feedback_v`, of either sign (V).
    """

    def __init__(self, settings: FeedbackSettings, stage: StageClock) -> None:
        self._settings, self._stage = settings, stage
        self.max_feedback_v = min(settings.max_feedback_v, stage.max_feedback_v)
        self._designs: dict[tuple[str, str, int], FeedbackController] = {}
        self._axes_laws: dict[str, AxesLaw] = {}

    def of_mode(self, mode: str, model: StageModel, model_sha256: str,
                plan: TrackingPlan) -> Feedback:
        """Return the feedback of a mode of `FEEDBACK_METHODS`, which acts together with a plan.

        Raises ValueError if the file, the weights or the design cannot be used.
        """
        settings, stage = self._settings, self._stage
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        controller = self._controller(mode, model, model_sha256, answered=True)
        if not composite:
            return MultirateFeedback(controller, self._room_v(plan))
        if settings.place == "behind_inverse" or not isinstance(plan, FeedforwardPlan):
            return self.limited(controller)
        return FeedbackBeforeInverse(
            controller, model, plan, stage.samples_per_tick, self.max_feedback_v,
            stage.rest_voltage_v)

    def law_of_mode(self, mode: str, model: StageModel, model_sha256: str,
                    plan: TrackingPlan) -> FeedbackLaw | None:
        """Return the feedback of a mode as a law for the stage to evaluate; see `of_mode`.

        It is None where the feedback is answered block by block.
        """
        if self._settings.loop != "onboard" or not isinstance(plan, FeedforwardPlan):
            return None
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        return onboard_law(
            self._controller(mode, model, model_sha256, answered=False), model, plan,
            self._stage.sample_period_s,
            self.max_feedback_v if composite else self._room_v(plan),
            before_inverse=composite and self._settings.place == "before_inverse",
            max_error_um=self._settings.max_error_um if composite else math.inf)

    def law_of_axes(self, model: CoupledModel, model_sha256: str) -> AxesLaw:
        """Return the feedback of the mode composite for several axes, designed or from its file.

        Raises ValueError if the file, the weights or the design cannot be used, or blocks are to be
        answered.
        """
        if self._settings.loop != "onboard":
            raise ValueError("the blocks of several axes are not answered: set feedback to onboard")
        if self._settings.controller_file:
            return load_axes_law(self._settings.controller_file)
        if model_sha256 not in self._axes_laws:
            self._axes_laws[model_sha256] = design_axes_feedback(
                model, self._weights(), model_sha256)
        return self._axes_laws[model_sha256]

    def sensitivity(self, mode: str, model: StageModel, model_sha256: str) -> Sensitivity:
        """Return the part of a reference that remains as error in open loop, with PID or PI."""
        stage = self._stage
        if mode not in FEEDBACK_METHODS:
            return open_loop_sensitivity(model, stage.sample_period_s)
        controller = self._controller(mode, model, model_sha256, answered=True)

        def residual(frequency_hz: FloatArray) -> ComplexArray:
            within = frequency_hz < 0.5 / stage.tick_s  # above this, the ticks see an alias
            residual = np.ones(frequency_hz.size, dtype=complex)
            residual[within] = fast_sensitivity(
                model, controller, frequency_hz[within], stage.sample_period_s)
            return residual

        return residual

    def check_model(self, model: StageModel, model_sha256: str, present: StageModel) -> None:
        """Raise ValueError if the composite feedback for a model is unstable with it or another.

        The other one is the present model: a stage that has changed lies near both. The design is
        cached for the next run.
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
        """Return the largest voltage (V) of a feedback that must provide the whole travel."""
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
            # A controller of another tool: it stabilises the model, so also at this gain.
            nominal = nominal_hysteresis_gain(model)
            controller = replace(controller, report={
                **controller.report, "hysteresis_gain_um_per_v": nominal})
        return controller

    def with_controller(self, path: str, mode: str) -> "Feedbacks":
        """Return a copy whose controller of the composite modes comes from a file, if there is one.

        Raises ValueError if the feedback of the mode does not come from a file.
        """
        if not path:
            return self
        if FEEDBACK_METHODS.get(mode) != "h_infinity":
            raise ValueError(f"a controller file has nothing to act on in the mode {mode!r}: "
                             "leave it out, or use composite")
        return Feedbacks(replace(self._settings, controller_file=path), self._stage)

    def limited(self, controller: FeedbackController) -> Feedback:
        """Return a feedback that acts behind the inverse, limited to its largest voltage."""
        return MultirateFeedback(controller, self.max_feedback_v)

    def _weights(self) -> DesignWeights:
        return load_weights(self._settings.weights or DEFAULT_WEIGHTS).at_tick(self._stage.tick_s)

    def _design(self, method: str, model: StageModel, model_sha256: str,
                delay_ticks: int) -> FeedbackController:
        key = model_sha256, method, delay_ticks
        if key not in self._designs:
            self._designs[key] = design_feedback(
                model, self._weights(), self._stage.sample_period_s, model_sha256, method,
                delay_ticks=delay_ticks)
        return self._designs[key]
