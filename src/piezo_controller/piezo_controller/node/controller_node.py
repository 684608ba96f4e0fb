# SPDX-License-Identifier: BSD-3-Clause
"""Track references with the stage: the action ``controller/track``."""

import dataclasses
import functools
import hashlib
import json
import math
import time
from pathlib import Path

import numpy as np
from piezo_interfaces.action import Track
from rclpy.lifecycle import LifecycleNode

from piezo_controller.feedback.controller_file import load_stabilising_controller
from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.integral_feedback import design_integral_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import DEFAULT, load_weights
from piezo_controller.feedforward.streamed import StreamPlan
from piezo_controller.learning.learned_file import (
    Learned,
    learned_path,
    load_correction,
    save_learned,
)
from piezo_controller.learning.learning_feedforward import LearningFeedforward
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.run_plan import plan_learning, plan_references
from piezo_controller.tracking.tracking_modes import FEEDBACK_METHODS, StageClock, feedback_room_v
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.model_file import load_model
from piezo_ros.calls import CallFailed
from piezo_ros.goals import GoalServers
from piezo_ros.parameters import declare, declare_data_root
from piezo_ros.spinning import autostart, run_node
from piezo_ros.stage_runs.recording_calls import RecorderCaller
from piezo_ros.stage_runs.run_account import RunAccount, declare_run_limits
from piezo_ros.stage_runs.stage_tracking import REPORT_PERIOD_S, StageTracker

PLACES = ("behind_inverse", "before_inverse")
LONGEST_DURATION_S = 3600.0
LEARNING_ITERATIONS = 10


class ControllerNode(LifecycleNode):
    """Plan the feedforward, let the stage play it, and answer its blocks."""

    def __init__(self):
        super().__init__("controller")
        self._declare_parameters()
        self._feedback_designs = {}
        self._tracker = StageTracker(self)
        self._recorder = RecorderCaller(self)
        self._goals = GoalServers(self)
        self._goals.serve(Track, "controller/track", self._track)
        autostart(self)

    def _declare_parameters(self):
        self._stage = StageClock(
            voltage_range_v=(
                declare(self, "minimum_voltage_v", -20.0,
                        "Lowest voltage of the feedforward (V).", -1000.0, 1000.0),
                declare(self, "maximum_voltage_v", 120.0,
                        "Highest voltage of the feedforward (V).", -1000.0, 1000.0)),
            slew_limit_v_per_s=declare(
                self, "slew_limit_v_per_s", 2.0e6, "Slew limit of the stage (V/s).", 1.0, 1.0e9),
            rest_voltage_v=declare(
                self, "rest_voltage_v", 0.0, "Voltage of the stage at rest (V).",
                -1000.0, 1000.0),
            sample_rate_hz=declare(
                self, "sample_rate_hz", 40000.0,
                "Rate of the stage's sample clock (Hz).", 1000.0, 200000.0),
            samples_per_tick=declare(
                self, "samples_per_tick", 40, "Samples of one feedback period.", 1, 4000))
        self._max_feedback_v = declare(
            self, "max_feedback_v", 20.0, "Largest feedback voltage (V).", 0.001, 1000.0)
        self._weights_file = declare(
            self, "weights", "",
            "Weights of the feedback design: a file (YAML), thesis, or empty for the default.")
        self._controller_file = declare(
            self, "controller_file", "",
            "Feedback of the composite modes, as design wrote it; empty to design it for the "
            "model.")
        self._feedback_place = declare(
            self, "feedback_place", PLACES[0],
            "Where the feedback of the composite modes enters: behind_inverse, as a voltage; "
            "before_inverse, as an output of the hysteresis.", choices=PLACES)
        self._data_root = declare_data_root(self)
        self._directory = declare(
            self, "directory", "runs", "Where recordings go if a goal names no place.")
        self._run_limits = declare_run_limits(self)

    def wind_down(self):
        """Cancel what runs; return whether it has ended."""
        return self._goals.end()

    def _track(self, goal, result, progress):
        directory = self._data_root.writable(goal.directory or self._directory)
        self._locate_files(goal)
        model_text = _read_text(goal.model)
        run, plan, feedback, save = self._plan(goal, model_text, directory, progress)
        progress.check()
        account = RunAccount(**self._run_limits, answered=feedback is not None,
                             streamed=isinstance(plan, (StreamPlan, LearningFeedforward)))
        with self._recorder.record(directory, f"track_{goal.mode}", {
                "model.json": model_text, "parameters.json": _parameters(goal)},
                goal.unrecorded) as recording:
            result.recording = recording.path
            try:
                self._play(run, plan, account, feedback is not None, progress, recording)
            finally:
                recording.last_sample = self._tracker.last_sample
                result.missed_feedback = self._tracker.missed_feedback
                if run.begun:
                    result.e_rms_percent = run.e_rms_percent()
                    result.largest_error_um = run.largest_error_um
                    result.settled_after_s = (
                        run.settled_after_sample * self._stage.sample_period_s)
            if not (run.complete or progress.cancelled or recording.must_stop):
                raise CallFailed(
                    f"the stage stopped before the end: {self._tracker.why_ended()}")
        progress.check()
        learned = save and not account.failure and save(result)
        uncompensated = plan.uncompensated and (
            f'the feedforward does not compensate: {", ".join(plan.uncompensated)}')
        notes = learned, uncompensated, run.lateness, recording.note
        if account.failure:
            raise CallFailed("; ".join(filter(None, (account.failure, *notes))))
        result.message = "; ".join(filter(None, (account.note, *notes)))

    def _locate_files(self, goal):
        """Take the relative paths of files to read from the data root."""
        goal.model = self._data_root.readable(goal.model)
        for reference in (goal.reference, *goal.then):
            reference.file = self._data_root.readable(reference.file)

    def _plan(self, goal, model_text, directory, progress):
        if not 0.0 < goal.duration_s <= LONGEST_DURATION_S:
            raise ValueError(f"duration_s is {goal.duration_s:g}: "
                             f"give more than 0 and at most {LONGEST_DURATION_S:g} s")
        if not 0.0 <= goal.tolerance_um < math.inf:
            raise ValueError(f"tolerance_um is {goal.tolerance_um:g}: give a positive number, or 0")
        model = load_model(goal.model).model
        durations_s = [goal.duration_s, *goal.then_duration_s]
        feedback = save = None
        preparing = _Preparing(progress, goal.tolerance_um)
        preparing.watch(0.0)
        if goal.mode == "learning":
            plan, feedback, save = self._plan_learning(goal, model, model_text, directory)
        else:
            plan = plan_references(
                goal.mode, [_reference(message) for message in (goal.reference, *goal.then)],
                durations_s, model, self._stage, goal.inversion, preparing.watch)
        if goal.mode in FEEDBACK_METHODS:
            preparing.begin("design the feedback")
            feedback = self._feedback(goal.mode, model, model_text, plan)
        run = TrackingRun(plan, self._whole_ticks(sum(durations_s)), feedback, self._stage.tick_s,
                          goal.tolerance_um, round(REPORT_PERIOD_S * self._stage.sample_rate_hz))
        return run, plan, feedback, save

    def _plan_learning(self, goal, model, model_text, directory):
        """Plan, feedback, and what to call at the end: it keeps what was learned, and tells."""
        if goal.then or goal.inversion:
            raise ValueError("learning repeats one reference by its exact inverse: "
                             "leave then and inversion empty")
        reference, key = _reference(goal.reference), _sha256(model_text)
        path = self._data_root.writable(goal.learned or learned_path(directory, reference, key))
        correction_um = None
        if goal.learned or path.exists():
            correction_um = load_correction(path, reference, key, self._stage.sample_rate_hz)
        controller = design_integral_feedback(
            model, self._stage.tick_s, self._stage.sample_period_s, key)
        samples = self._whole_ticks(goal.duration_s)
        plan, learner = plan_learning(reference, samples, model, controller, self._stage,
                                      goal.iterations or LEARNING_ITERATIONS, correction_um)

        def save(result):
            save_learned(path, Learned(
                reference, key, self._stage.sample_rate_hz, learner.best_um, learner.best_rms_um,
                learner.iterations))
            result.learned, result.iterations = str(path), learner.iterations
            return f"learning ended after {learner.iterations} iterations: {learner.finished}"

        return plan, MultirateFeedback(controller, self._max_feedback_v), save

    def _whole_ticks(self, duration_s):
        ticks = math.ceil(duration_s / self._stage.tick_s - 1e-9)
        return ticks * self._stage.samples_per_tick

    def _feedback(self, mode, model, model_text, plan):
        composite = FEEDBACK_METHODS[mode] == "h_infinity"
        if composite and self._controller_file:
            controller = load_stabilising_controller(
                self._controller_file, model, self._stage.tick_s, self._stage.sample_period_s)
        else:
            controller = self._design_feedback(FEEDBACK_METHODS[mode], model, model_text)
        if not composite:
            # All of the travel is the feedback's work.
            return MultirateFeedback(
                controller, feedback_room_v(plan, self._stage.voltage_range_v))
        if self._feedback_place == "behind_inverse":
            return MultirateFeedback(controller, self._max_feedback_v)
        if isinstance(plan, StreamPlan):
            raise ValueError("a streamed reference takes its feedback behind the inverse: set "
                             "feedback_place to behind_inverse")
        return FeedbackBeforeInverse(
            controller, model, plan, self._stage.samples_per_tick, self._max_feedback_v,
            self._stage.rest_voltage_v)

    def _design_feedback(self, method, model, model_text):
        digest = _sha256(model_text)
        if (digest, method) not in self._feedback_designs:
            weights = load_weights(self._weights_file or DEFAULT).at_tick(self._stage.tick_s)
            self._feedback_designs[digest, method] = design_feedback(
                model, weights, self._stage.sample_period_s, digest, method)
        return self._feedback_designs[digest, method]

    def _play(self, run, plan, account, answering, progress, recording):
        ticks, more = math.ceil(run.total_samples / self._stage.samples_per_tick), None
        period_v = getattr(plan, "period_voltage_v", np.empty(0))
        learning = isinstance(plan, LearningFeedforward)
        if isinstance(plan, StreamPlan):
            more = functools.partial(next, plan.chunks(), np.empty(0))
        elif learning:
            ticks, more = 0, plan.next_voltage_v  # how long is not known yet

        def take(block):
            displacement_um = np.frombuffer(block.displacement_um)
            if not run.complete:
                account.take(block.flags)
            if learning:
                plan.take(displacement_um)
            return run.take(displacement_um)

        def shall_end():
            return (progress.cancelled or recording.must_stop
                    or (learning and run.complete))

        def report():
            progress.report(
                run.fraction, stage="play", e_rms_percent=run.e_rms_percent(running=True),
                on_target=run.on_target, tolerance_um=run.tolerance_um,
                iteration=plan.iteration if learning else 0)

        self._tracker.run(plan.once_voltage_v, period_v, ticks, take, answering, shall_end,
                          report, more)


class _Preparing:
    """Tells what is done before the run, and lets it be cancelled."""

    def __init__(self, progress, tolerance_um):
        self._progress, self._tolerance_um = progress, tolerance_um
        self._stage, self._told_s = "plan", -math.inf

    def begin(self, stage):
        """Tell that another stage begins."""
        self._stage, self._told_s = stage, -math.inf
        self.watch(0.0)

    def watch(self, fraction):
        """Tell how much of the present stage is done; raise ``Cancelled`` if it shall end."""
        self._progress.check()
        now_s = time.monotonic()
        if now_s - self._told_s >= REPORT_PERIOD_S:
            self._told_s = now_s
            self._progress.report(fraction, stage=self._stage, e_rms_percent=math.nan,
                                  tolerance_um=self._tolerance_um)


def _sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


def _reference(message):
    return Reference(
        message.kind, tuple(message.frequency_hz), tuple(message.amplitude_um),
        tuple(message.phase_rad), message.centre_um, message.file, message.once, message.axis,
        message.lines, message.seed)


def _read_text(path):
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"cannot read the model {path!r}: {reason}; "
                         "identify the stage first, or give the path of its model") from None


def _parameters(goal):
    references = [dataclasses.asdict(_reference(message))
                  for message in (goal.reference, *goal.then)]
    return json.dumps({
        "mode": goal.mode, "duration_s": goal.duration_s, "reference": references[0],
        "then": references[1:], "then_duration_s": list(goal.then_duration_s),
        "inversion": goal.inversion}, indent=1)


def main(args=None):
    """Run the node ``controller``."""
    run_node(ControllerNode, args)
