# SPDX-License-Identifier: BSD-3-Clause
"""Plan the references of a goal: as a repeated period, streamed, or learned."""

from collections.abc import Sequence

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedforward.live import LivePlan, plan_live
from piezo_controller.feedforward.periodic import FeedforwardPlan, FeedforwardPlanner
from piezo_controller.feedforward.streamed import StreamPlan, plan_stream
from piezo_controller.learning.learning_feedforward import LearningFeedforward
from piezo_controller.learning.periodic_learner import PeriodicLearner
from piezo_controller.learning.slow_feedback import fast_sensitivity
from piezo_controller.references.kind import Reference, Watch, one_component
from piezo_controller.references.live_reference import LiveReference
from piezo_controller.references.reference import (
    LONGEST_DURATION_S,
    InvalidReference,
    is_periodic,
    sample_reference,
    trajectory,
)
from piezo_controller.references.trajectory import JoinedTrajectory
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import zoh_response

STREAMED_MODES = ("feedforward", "composite")
TRANSITION_S = 0.05


def plan_references(mode: str, references: Sequence[Reference], durations_s: Sequence[float],
                    model: StageModel, stage: StageClock, inversion: str = "",
                    watch: Watch | None = None) -> FeedforwardPlan | StreamPlan:
    """Plan the feedforward of one reference, or of several that follow each other.

    Each reference has a duration; a transition begins where the previous reference ends, and is
    part of the next one. The modes are those of `plan_mode`. An empty inversion is the exact
    inverse of a period, if there is one; otherwise it names the method of `preview_inverse` for an
    online inverse. Raises ValueError if a reference is invalid, or a planner cannot reach it.
    """
    if len(references) != len(durations_s):
        raise InvalidReference(f"then has {len(references) - 1} references and then_duration_s "
                               f"{len(durations_s) - 1} times: give one for each")
    for duration_s in durations_s:
        if not TRANSITION_S <= duration_s <= LONGEST_DURATION_S and len(durations_s) > 1:
            raise InvalidReference(f"a reference of {duration_s:g} s cannot be joined to others: "
                                   f"give {TRANSITION_S:g} to {LONGEST_DURATION_S:g} s")
    rate_hz = stage.sample_rate_hz
    streamed = inversion or len(references) > 1 or not is_periodic(references[0], rate_hz)
    if not streamed:
        return plan_mode(mode, references[0], model, stage, durations_s[0], watch)
    if mode not in STREAMED_MODES:
        raise InvalidReference(f"{mode} plays one reference that has a period: use "
                               f"{' or '.join(STREAMED_MODES)} for others, and with an inversion")
    ways = [trajectory(reference, rate_hz, watch) for reference in references]
    durations = [round(duration_s * rate_hz) for duration_s in durations_s]
    way = ways[0] if len(ways) == 1 else JoinedTrajectory(
        ways, durations, round(TRANSITION_S * rate_hz))
    return plan_stream(way, sum(durations), model, inversion or "least_squares",
                       stage=stage, watch=watch)


def plan_topic(mode: str, references: Sequence[Reference], run_samples: int, model: StageModel,
               stage: StageClock, inversion: str, live: LiveReference | None) -> LivePlan:
    """Plan to follow a reference that is published during the run; `live` is what came so far.

    Raises ValueError if there is more than one reference, it does not declare its frequency and
    amplitude, or the planner cannot reach it.
    """
    reference = references[0]
    if live is None or len(references) > 1 or inversion or mode not in STREAMED_MODES:
        raise InvalidReference(
            f"a published reference is followed alone, in the modes {' and '.join(STREAMED_MODES)} "
            "of the controller's node: leave then and inversion empty")
    band_hz, amplitude_um, _ = one_component(reference, stage.sample_rate_hz)
    return plan_live(live, band_hz, amplitude_um, run_samples, model,
                     centre_um=reference.centre_um, stage=stage)


def plan_learning(reference: Reference, run_samples: int, model: StageModel,
                  controller: FeedbackController, stage: StageClock, iterations: int,
                  correction_um: FloatArray | None = None,
                  ) -> tuple[LearningFeedforward, PeriodicLearner]:
    """Plan to learn the feedforward of a periodic reference, and then to play the best one.

    The controller acts during the learning, which takes some iterations at most, from a correction,
    (P,), if there is one; the best is then played for whole ticks. Raises ValueError if the
    reference has no period, or is far out of reach.
    """
    reference_um = sample_reference(reference, stage.sample_rate_hz)
    if correction_um is not None and correction_um.size != reference_um.size:
        raise InvalidReference(f"the learned correction has {correction_um.size} samples, the "
                               f"reference {reference_um.size}: learn again")
    linear, period_s = model.linear(), stage.sample_period_s
    learner = PeriodicLearner(
        reference_um,
        lambda frequency_hz: fast_sensitivity(model, controller, frequency_hz, period_s),
        lambda frequency_hz: 1 / zoh_response(linear, frequency_hz, period_s),
        period_s, correction_um)
    planner = FeedforwardPlanner(reference_um.size, model, stage=stage,
                                 duration_s=run_samples * period_s)
    feedforward = LearningFeedforward(planner, reference_um, learner, iterations, run_samples,
                                      stage.samples_per_tick)
    return feedforward, learner
