# SPDX-License-Identifier: BSD-3-Clause
"""Track references with the stage: the action ``controller/track``."""

import dataclasses
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import piezo_interfaces.msg as messages
from piezo_interfaces.action import Track
from piezo_interfaces.msg import SampleBlock, StageDescription
from rclpy.lifecycle import LifecycleNode

from piezo_controller.axes.followed_scan import AxesStage
from piezo_controller.feedback.synthesis.weights import BUILT_IN
from piezo_controller.node.model_service import ModelService
from piezo_controller.node.present_run import PresentRun
from piezo_controller.node.reference_topic import FollowedReference, ReferenceTopic
from piezo_controller.references.live_reference import TOPIC
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.accepted_models import ModelText
from piezo_controller.tracking.feedbacks import LOOPS, PLACES, Feedbacks, FeedbackSettings
from piezo_controller.tracking.pace import check_pace
from piezo_controller.tracking.path_run import prepare_path
from piezo_controller.tracking.track import (
    Learning,
    PreparedRun,
    Steps,
    TrackRequest,
    prepare,
)
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models.cascade import StageModel
from piezo_ros.parameters import declare, declare_data_root
from piezo_ros.requests.calls import CallFailed
from piezo_ros.requests.goals import GoalServers, Progress
from piezo_ros.spinning import autostart, run_node
from piezo_ros.stage_runs.described_stage import DescribedStage
from piezo_ros.stage_runs.law_message import message_of
from piezo_ros.stage_runs.recording_calls import Attachment, RecorderCaller, RunRecording
from piezo_ros.stage_runs.run_account import RunAccount, declare_run_limits
from piezo_ros.stage_runs.stage_tracking import REPORT_PERIOD_S, StageTracker

SWITCH_INTERVAL_S = 2e-4


class ControllerNode(LifecycleNode):
    """Plan the feedforward, let the stage play it, and answer its blocks."""

    def __init__(self) -> None:
        super().__init__("controller")
        self._data_root = declare_data_root(self)
        self._feedback_settings = FeedbackSettings(
            max_feedback_v=declare(
                self, "max_feedback_v", 20.0,
                "Largest feedback voltage added to a feedforward (V).", 0.001, 1000.0),
            weights=self._weights(declare(
                self, "weights", "",
                "Weights of the feedback design: a file (YAML), thesis, or empty for the default."
            )),
            controller_file=self._data_root.readable(declare(
                self, "controller_file", "",
                "Feedback of the composite modes, as design wrote it; empty to design it for the "
                "model.")),
            place=declare(
                self, "feedback_place", PLACES[0],
                "Where the feedback of the composite modes enters: before_inverse, as an output of "
                "the hysteresis; behind_inverse, as a voltage, as for every streamed feedforward.",
                choices=PLACES),
            loop=declare(
                self, "feedback", LOOPS[0],
                "Who evaluates the feedback: onboard, the stage, which takes it as a law; remote, "
                "this node, block by block, as for every streamed or learned feedforward.",
                choices=LOOPS),
            max_error_um=declare(
                self, "max_error_um", 4.0,
                "A law on board stops the stage where its error exceeds by more what there was "
                "before it began (um).", 0.001, 1.0e6))
        self._directory = declare(
            self, "directory", "runs", "Where recordings go if a goal names no place.")
        self._run_limits = declare_run_limits(self)
        self._stage = DescribedStage(self)
        self._designed: tuple[StageClock, Feedbacks] | None = None
        self._tracker = StageTracker(self)
        self._references = ReferenceTopic(self, self._tracker.wake)
        self._followed = FollowedReference(self)
        self._recorder = RecorderCaller(self)
        self._models = ModelService(self, self._data_root.readable, self._check_model)
        self._goals = GoalServers(self)
        self._goals.serve(Track, "controller/track", self._track)
        autostart(self)

    def wind_down(self) -> bool:
        """Cancel the goal in progress; return whether it has ended."""
        return self._goals.end()

    def _track(self, goal: Track.Goal, result: Track.Result, progress: Progress) -> None:
        try:
            self._prepare_and_play(goal, result, progress)
        finally:
            self._references.end()

    def _prepare_and_play(self, goal: Track.Goal, result: Track.Result,
                          progress: Progress) -> None:
        directory = self._data_root.writable(goal.directory or self._directory)
        self._locate_files(goal)
        named, model, replaced = self._models.model_for(goal.model)
        described = self._stage.wait(progress.check, several_axes=True)
        clock = _clock(described)
        live = None if goal.reference.kind != TOPIC or described.axes else self._references.begin(
            clock.sample_period_s, described.timing == "lockstep", goal.reference.centre_um,
            progress.check)
        request = _request(goal, model, directory)
        feedbacks = self._feedbacks(clock).with_controller(goal.controller, goal.mode)

        def prepared_for(asked: TrackRequest, steps: Steps) -> PreparedRun:
            if described.axes:
                return prepare_path(asked, clock, AxesStage.of(described), feedbacks, steps,
                                    REPORT_PERIOD_S)
            return prepare(asked, clock, feedbacks, steps, self._data_root.writable,
                           REPORT_PERIOD_S, live)

        prepared = prepared_for(request, _Preparing(progress, goal.tolerance_um))
        present = PresentRun(
            request, named, prepared, lambda other: prepared_for(other, Steps()),
            self._tracker, clock.tick_s)
        progress.check()
        self._stage.check_unchanged(described)
        run, plan = prepared.run, prepared.plan
        if described.timing == "paced" and (prepared.feedback is not None or plan.streamed):
            check_pace(clock.tick_s, described.max_missed_feedback, progress.check)
        account = RunAccount(**self._run_limits, answered=prepared.feedback is not None,
                             streamed=plan.streamed)
        with self._recorder.record(directory, f"track_{goal.mode}", {
                "model.json": Attachment(model.text, model.path),
                "parameters.json": Attachment(_parameters(goal)),
                **{name: Attachment(text) for name, text in prepared.attachments.items()}},
                goal.unrecorded) as recording:
            result.recording = recording.path
            try:
                with self._models.playing(present):
                    self._play(prepared, clock, account, progress, recording)
            finally:
                self._followed.flush()
                recording.last_sample = self._tracker.last_sample
                result.missed_feedback = self._tracker.missed_feedback
                result.degraded_reason = "; ".join(filter(None, (account.failure, plan.degraded)))
                result.degraded = bool(result.degraded_reason)
                if run.begun:
                    result.e_rms_percent = run.e_rms_percent()
                    result.largest_error_um = run.largest_error_um
                    result.settled_after_s = (
                        run.settled_after_sample * clock.sample_period_s)
            if not (run.complete or progress.cancelled or recording.must_stop):
                raise CallFailed(
                    f"the stage stopped before the end: {self._tracker.why_ended()}")
        progress.check()
        learned = "" if result.degraded else _keep_learned(prepared.learning, result)
        uncompensated = (
            f'the feedforward does not compensate: {", ".join(plan.uncompensated)}'
            if plan.uncompensated else "")
        notes = (replaced, present.note, learned, uncompensated, run.note, plan.note,
                 recording.note)
        if result.degraded:
            raise CallFailed("; ".join(filter(None, (result.degraded_reason, *notes))))
        result.message = "; ".join(filter(None, (account.note, *notes)))

    def _feedbacks(self, clock: StageClock) -> Feedbacks:
        """Return the feedbacks for a stage; designs are cached until the stage changes."""
        if self._designed is None or self._designed[0] != clock:
            self._designed = clock, Feedbacks(self._feedback_settings, clock)
        return self._designed[1]

    def _check_model(self, model: StageModel, model_sha256: str, present: StageModel) -> None:
        """Design the feedback for a model; raise if it is unstable."""
        clock = _clock(self._stage.wait(lambda: None))
        self._feedbacks(clock).check_model(model, model_sha256, present)

    def _weights(self, given: str) -> str:
        """Return the name of built-in weights, or the path of a file."""
        return given if given in BUILT_IN else self._data_root.readable(given)

    def _locate_files(self, goal: Track.Goal) -> None:
        """Resolve relative paths of input files against the data root."""
        goal.model = self._data_root.readable(goal.model)
        goal.controller = self._data_root.readable(goal.controller)
        for reference in (goal.reference, *goal.then):
            reference.file = self._data_root.readable(reference.file)

    def _play(self, prepared: PreparedRun, clock: StageClock, account: RunAccount,
              progress: Progress, recording: RunRecording) -> None:
        plan, run = prepared.plan, prepared.run

        def take(block: SampleBlock) -> float:
            if not run.complete:
                samples = len(block.displacement_um) // max(len(block.axes), 1)
                account.take(block.flags, samples // clock.samples_per_tick)
            answer_v = prepared.take(np.frombuffer(block.displacement_um))
            self._followed.take(block, run.expected_um)
            return answer_v

        def shall_end() -> bool:
            return progress.cancelled or recording.must_stop or prepared.over

        def report() -> None:
            progress.report(
                run.fraction, stage="play", e_rms_percent=run.e_rms_percent(running=True),
                on_target=run.on_target, tolerance_um=run.tolerance_um, iteration=plan.iteration)

        self._tracker.run(
            plan.once_voltage_v, plan.period_voltage_v,
            prepared.ticks(clock.samples_per_tick), take, prepared.feedback is not None,
            shall_end, report, plan.continuation(),
            None if prepared.law is None else message_of(prepared.law), prepared.axes,
            prepared.marks)


def _clock(described: StageDescription) -> StageClock:
    """Return the clock and limits of a stage, from its description."""
    return StageClock(
        voltage_range_v=(described.minimum_voltage_v, described.maximum_voltage_v),
        slew_limit_v_per_s=described.slew_limit_v_per_s,
        rest_voltage_v=described.rest_voltage_v, sample_rate_hz=described.sample_rate_hz,
        samples_per_tick=described.samples_per_tick, max_feedback_v=described.max_feedback_v)


def _keep_learned(learning: Learning | None, result: Track.Result) -> str:
    """Write the learned feedforward, if there is one; return a note on it."""
    if learning is None:
        return ""
    learning.keep()
    result.learned, result.iterations = str(learning.path), learning.learner.iterations
    return learning.account


class _Preparing(Steps):
    """Reports the steps before the run, and lets it be cancelled."""

    def __init__(self, progress: Progress, tolerance_um: float) -> None:
        self._progress, self._tolerance_um = progress, tolerance_um
        self._step, self._reported_s = "", -math.inf

    def begin(self, step: str) -> None:
        """Report that another step begins."""
        self._step, self._reported_s = step, -math.inf
        self.watch(0.0)

    def watch(self, fraction: float) -> None:
        """Report the fraction of the present step; raise ``Cancelled`` if the run is cancelled."""
        self._progress.check()
        now_s = time.monotonic()
        if now_s - self._reported_s >= REPORT_PERIOD_S:
            self._reported_s = now_s
            self._progress.report(fraction, stage=self._step, e_rms_percent=math.nan,
                                  tolerance_um=self._tolerance_um)


def _request(goal: Track.Goal, model: ModelText, directory: Path) -> TrackRequest:
    return TrackRequest(
        mode=goal.mode, model=model.path, model_sha256=model.sha256,
        references=[_reference(message) for message in (goal.reference, *goal.then)],
        durations_s=[goal.duration_s, *goal.then_duration_s], tolerance_um=goal.tolerance_um,
        inversion=goal.inversion, learned=goal.learned, iterations=goal.iterations,
        directory=str(directory))


def _reference(message: messages.Reference) -> Reference:
    return Reference(
        message.kind, tuple(message.frequency_hz), tuple(message.amplitude_um),
        tuple(message.phase_rad), message.centre_um, message.file, message.once, message.axis,
        message.lines, message.seed)


def _parameters(goal: Track.Goal) -> str:
    references = [dataclasses.asdict(_reference(message))
                  for message in (goal.reference, *goal.then)]
    return json.dumps({
        "mode": goal.mode, "duration_s": goal.duration_s, "reference": references[0],
        "then": references[1:], "then_duration_s": list(goal.then_duration_s),
        "inversion": goal.inversion, "controller": goal.controller}, indent=1)


def main(args: list[str] | None = None) -> None:
    """Run the node ``controller``."""
    # A planning thread holds the interpreter lock for no longer than this while another answers.
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    run_node(ControllerNode, args)
