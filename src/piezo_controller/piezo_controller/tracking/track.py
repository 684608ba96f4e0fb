# SPDX-License-Identifier: BSD-3-Clause
"""The steps from a request to track to the run that answers the stage's blocks.

`prepare` checks the request, loads the model, plans the voltages, makes the feedback, and joins
them in a `TrackingRun`. The stage then plays the plan; each block of samples goes to
`PreparedRun.take`. At the end `PreparedRun.keep_learned` writes what was learned.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.onboard_law import FADE_S
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.learning.learned_file import (
    find_like,
    learned_path,
    load_correction,
    save_learned,
)
from piezo_controller.learning.periodic_learner import PeriodicLearner
from piezo_controller.learning.slow_feedback import design_integral_feedback
from piezo_controller.references.live_reference import TOPIC, LiveReference
from piezo_controller.references.reference import LONGEST_DURATION_S, Reference
from piezo_controller.tracking.feedbacks import Feedback, Feedbacks
from piezo_controller.tracking.foreseen import check_reach
from piezo_controller.tracking.run_plan import plan_learning, plan_references, plan_topic
from piezo_controller.tracking.tracking_modes import FEEDBACK_METHODS, StageClock
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.feedback_law import FeedbackLaw
from piezo_models.model_file import load_model

if TYPE_CHECKING:
    from piezo_controller.tracking.path_run import AxesTrackingRun

LEARNING_ITERATIONS = 10
WITHOUT_INVERSE = "open_loop", "pid", "pi"


@dataclass(frozen=True)
class TrackRequest:
    """The contents of a goal of ``controller/track``."""

    mode: str
    """One of `tracking_modes.MODES`."""
    model: str
    model_sha256: str
    """Path of the model's file, and the hash of its text."""
    references: Sequence[Reference]
    durations_s: Sequence[float]
    """References in the order in which they are followed, and the duration of each."""
    tolerance_um: float = 0.0
    """Tolerance of the rms error, see `TrackingRun`."""
    inversion: str = ""
    """Method of the inverse, see `plan_references`."""
    learned: str = ""
    """File of a learned feedforward; empty to derive its name from the request, in `directory`."""
    iterations: int = 0
    """Largest number of iterations of the learning; 0 for `LEARNING_ITERATIONS`."""
    directory: str = "."
    """Directory of learned feedforwards."""


class Steps:
    """Observer of the steps of a preparation, which does nothing; a method may raise to end it."""

    def begin(self, step: str) -> None:
        """Called when a step begins."""

    def watch(self, fraction: float) -> None:
        """Called with the fraction of the present step that is done (0 to 1)."""


@dataclass(frozen=True, eq=False)
class Learning:
    """A learning run: its learner, the file of the result, and what it started from."""

    learner: PeriodicLearner
    path: Path
    reference: Reference
    model_sha256: str
    sample_rate_hz: float
    beginning: str = ""

    @property
    def account(self) -> str:
        """Return a sentence that describes the learning at its end."""
        return (f"learning{self.beginning} ended after {self.learner.iterations} iterations: "
                f"{self.learner.finished}")

    def keep(self) -> None:
        """Write the best correction; raise `LearnedFileError` if that fails."""
        save_learned(
            self.path, self.reference, self.model_sha256, self.sample_rate_hz,
            self.learner.best_um, self.learner.best_rms_um, self.learner.iterations)


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run that is ready to be played by the stage."""

    plan: TrackingPlan
    feedback: Feedback | None
    run: "TrackingRun | AxesTrackingRun"

    learning: Learning | None = None
    """Only in the mode ``learning``."""
    law: FeedbackLaw | None = None
    """Law that the stage evaluates, instead of a feedback that answers block by block."""
    axes: tuple[str, ...] = ()
    """Names of the axes, if the stage has several; voltages then have a column for each."""
    marks: tuple[bytes, bytes] = (b"", b"")
    """Marks of the voltages that are played once, and of those that are repeated; see `Mark`."""
    attachments: Mapping[str, str] = field(default_factory=dict)
    """Texts to keep in the recording, by the names of their files."""

    def ticks(self, samples_per_tick: int) -> int:
        """Return the number of ticks to play; 0 if the length is not known in advance."""
        if self.plan.open_ended:
            return 0
        return math.ceil(self.run.total_samples / samples_per_tick)

    @property
    def over(self) -> bool:
        """Return whether an open-ended run is complete, so that the stage must be stopped."""
        return self.plan.open_ended and self.run.complete

    def take(self, displacement_um: FloatArray) -> float:
        """Take the displacements of a block, and return the answer to it (V)."""
        self.plan.take(displacement_um)
        return self.run.take(displacement_um)


def prepare(request: TrackRequest, stage: StageClock, feedbacks: Feedbacks, steps: Steps,
            writable: Callable[[str | Path], str | Path] = Path, window_s: float = 0.1,
            live: LiveReference | None = None) -> PreparedRun:
    """Prepare the run of a request.

    `writable` returns the path under which a file may be written, or raises ValueError if it may
    not. The running error has a window (s). Of a request of the kind ``topic``, at least one
    published value has come. Raises ValueError, which says what cannot be done, and what to change.
    """
    check_times(request)
    model = load_model(request.model).model
    steps.begin("plan")
    plan: TrackingPlan
    learning, law, feedback = None, None, None
    if any(reference.kind == TOPIC for reference in request.references):
        plan = plan_topic(request.mode, request.references,
                          whole_ticks(sum(request.durations_s), stage), model, stage,
                          request.inversion, live)
    elif request.mode == "learning":
        plan, feedback, learning = prepare_learning(request, model, stage, feedbacks, writable)
    else:
        plan = plan_references(request.mode, request.references, request.durations_s, model, stage,
                               request.inversion, steps.watch)
    if request.mode in FEEDBACK_METHODS:
        steps.begin("design the feedback")
        described = request.mode, model, request.model_sha256, plan
        law = feedbacks.law_of_mode(*described)
        feedback = None if law else feedbacks.of_mode(*described)
    if request.mode in WITHOUT_INVERSE:
        check_reach(plan.expected_um(plan.begin_sample, plan.period_voltage_v.size),
                    feedbacks.sensitivity(request.mode, model, request.model_sha256),
                    request.references[0], model, stage, request.durations_s[0], steps.watch)
    run = TrackingRun(plan, whole_ticks(sum(request.durations_s), stage), feedback, stage.tick_s,
                      request.tolerance_um, round(window_s * stage.sample_rate_hz), FADE_S)
    return PreparedRun(plan, feedback, run, learning, law)


def check_times(request: TrackRequest) -> None:
    """Raise ValueError if the first duration or the tolerance makes no sense."""
    duration_s, tolerance_um = request.durations_s[0], request.tolerance_um
    if not 0.0 < duration_s <= LONGEST_DURATION_S:
        raise ValueError(f"duration_s is {duration_s:g}: "
                         f"give more than 0 and at most {LONGEST_DURATION_S:g} s")
    if not 0.0 <= tolerance_um < math.inf:
        raise ValueError(f"tolerance_um is {tolerance_um:g}: give a positive number, or 0")


def prepare_learning(request: TrackRequest, model: StageModel, stage: StageClock,
                     feedbacks: Feedbacks, writable: Callable[[str | Path], str | Path],
                     ) -> tuple[TrackingPlan, Feedback, Learning]:
    """Plan to learn one reference, starting from the contents of its file if there is one.

    Raises ValueError if there are several references or an inversion, the file was learned for
    something else, or the planner cannot reach the reference.
    """
    if len(request.references) > 1 or request.inversion:
        raise ValueError("learning repeats one reference by its exact inverse: "
                         "leave then and inversion empty")
    reference, key = request.references[0], request.model_sha256
    path = Path(writable(request.learned or learned_path(request.directory, reference, key)))
    correction_um, beginning = None, ""
    if request.learned or path.exists():
        correction_um = load_correction(path, reference, key, stage.sample_rate_hz)
    elif like := find_like(request.directory, reference, key, stage.sample_rate_hz):
        beginning, correction_um = f" from {like[0].name} of a like reference", like[1]
    controller = design_integral_feedback(model, stage.tick_s, stage.sample_period_s, key)
    plan, learner = plan_learning(
        reference, whole_ticks(request.durations_s[0], stage), model, controller, stage,
        request.iterations or LEARNING_ITERATIONS, correction_um)
    return plan, feedbacks.limited(controller), Learning(
        learner, path, reference, key, stage.sample_rate_hz, beginning)


def whole_ticks(duration_s: float, stage: StageClock) -> int:
    """Return the number of samples of a duration, rounded up to whole ticks."""
    return math.ceil(duration_s / stage.tick_s - 1e-9) * stage.samples_per_tick
