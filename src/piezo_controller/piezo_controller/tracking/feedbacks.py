# SPDX-License-Identifier: BSD-3-Clause
"""The feedback that each mode of tracking adds, designed for the model or read from a file."""

from dataclasses import dataclass
from typing import Protocol

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.controller_file import load_stabilising_controller
from piezo_controller.feedback.design_choices import DEFAULT_WEIGHTS
from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.tracking.plan import TrackingPlan
from piezo_controller.tracking.tracking_modes import FEEDBACK_METHODS, StageClock, feedback_room_v
from piezo_models.cascade import StageModel

PLACES = ("behind_inverse", "before_inverse")


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
        Of `PLACES`: where the feedback of the composite modes enters.
    """

    max_feedback_v: float = 20.0
    weights: str = ""
    controller_file: str = ""
    place: str = PLACES[0]


class Feedbacks:
    """Makes the feedback of a run; a design for the same model is made once.

    Parameters
    ----------
    settings : FeedbackSettings
    stage : StageClock
    """

    def __init__(self, settings: FeedbackSettings, stage: StageClock) -> None:
        self._settings, self._stage = settings, stage
        self._max_feedback_v = min(settings.max_feedback_v, stage.max_feedback_v)
        self._designs: dict[tuple[str, str], FeedbackController] = {}

    def of_mode(self, mode: str, model: StageModel, model_sha256: str,
                plan: TrackingPlan) -> Feedback:
        """Make the feedback of a mode of `FEEDBACK_METHODS`.

        Parameters
        ----------
        mode : str
        model : StageModel
        model_sha256 : str
            Hash of the model's file.
        plan : TrackingPlan
            What is played beside it.

        Raises
        ------
        ValueError
            If the file, the weights or the design are unusable, or the feedback enters before the
            inverse of a plan that is streamed.
        """
        settings, stage = self._settings, self._stage
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        if composite and settings.controller_file:
            controller = load_stabilising_controller(
                settings.controller_file, model, stage.tick_s, stage.sample_period_s)
        else:
            controller = self._design(FEEDBACK_METHODS[mode], model, model_sha256)
        if not composite:
            # All of the travel is the feedback's work.
            return MultirateFeedback(controller, min(
                feedback_room_v(plan, stage.voltage_range_v), stage.max_feedback_v))
        if settings.place == "behind_inverse":
            return self.limited(controller)
        if not isinstance(plan, FeedforwardPlan):
            raise ValueError("a streamed reference takes its feedback behind the inverse: set "
                             "feedback_place to behind_inverse")
        return FeedbackBeforeInverse(
            controller, model, plan, stage.samples_per_tick, self._max_feedback_v,
            stage.rest_voltage_v)

    def limited(self, controller: FeedbackController) -> Feedback:
        """Run a controller behind the inverse, within the largest voltage of a feedback."""
        return MultirateFeedback(controller, self._max_feedback_v)

    def _design(self, method: str, model: StageModel, model_sha256: str) -> FeedbackController:
        key = model_sha256, method
        if key not in self._designs:
            weights = load_weights(
                self._settings.weights or DEFAULT_WEIGHTS).at_tick(self._stage.tick_s)
            self._designs[key] = design_feedback(
                model, weights, self._stage.sample_period_s, model_sha256, method)
        return self._designs[key]
