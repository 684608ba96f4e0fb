# SPDX-License-Identifier: BSD-3-Clause
"""Run the identification on a stage: experiments and the whole sequence as actions."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from piezo_interfaces.action import Diagnose, Identify, PlayWaveform, RunExperiment
from piezo_interfaces.msg import SampleBlock, StageAxis, StageDescription
from rclpy.lifecycle import LifecycleNode

from piezo_common.budget import Budget
from piezo_common.text_file import previous_of
from piezo_identification.adequacy.component_adequacy import overall_verdict
from piezo_identification.diagnosis.experiment_design.propose import LONGEST_S
from piezo_identification.diagnosis.report.diagnosis_report import verdict_sentence
from piezo_identification.diagnosis.report.diagnosis_results import (
    DiagnosisResults,
    decide_files,
    decision_sentence,
    diagnose_files,
)
from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_identification.experiments.catalogue import (
    EXPERIMENTS,
    Experiment,
    StageLimits,
    named_experiment,
)
from piezo_identification.experiments.probing import probe_file
from piezo_identification.experiments.probing.probe import NAME, Probe
from piezo_identification.experiments.relay_feedback import (
    RelayExperiment,
    RelayRun,
    relay_oscillation,
)
from piezo_identification.experiments.several_axes import axes_experiments
from piezo_identification.identification.identify import IdentificationCancelled, identify
from piezo_identification.recording_check.suitability import misfits
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording
from piezo_ros.parameters import declare, declare_data_root
from piezo_ros.requests.calls import ActionCaller, CallFailed, Cancelled, GoalAborted
from piezo_ros.requests.goals import GoalServers, Progress
from piezo_ros.spinning import autostart, run_node
from piezo_ros.stage_runs.described_stage import DescribedStage
from piezo_ros.stage_runs.recording_calls import Attachment, RecorderCaller, RunRecording, free_name
from piezo_ros.stage_runs.run_account import RunAccount, declare_run_limits
from piezo_ros.stage_runs.stage_tracking import StageTracker

# Fraction of the identify action's progress for the experiments; the rest is the estimation.
EXPERIMENTS_FRACTION = 0.5
# Called with the step of an experiment and the fraction done.
Report = Callable[[str, float], None]
# Model, recordings, held-out recording and result directory of a diagnosis.
DiagnosedFiles = tuple[str, list[str], str | None, Path]
BUDGET, LONGEST_BUDGET_S = "budget_s", 86_400.0
DIAGNOSIS_FILES = ("verdict.json", "extended_model.json", "report.html", "next_experiment.csv",
                   "next_experiment.json")


class IdentificationNode(LifecycleNode):
    """Serve the actions ``run_experiment``, ``identify`` and ``diagnose``."""

    def __init__(self) -> None:
        super().__init__("identification")
        self._stage = DescribedStage(self)
        self._data_root = declare_data_root(self)
        self._directory = declare(
            self, "directory", "runs", "Where recordings and models go if a goal names no place.")
        self._refine = declare(
            self, "refine", False, "Of earlier versions: identify always does so now.")
        declare(self, BUDGET, 0.0, "Time after which the searches of identify, and of each "
                "diagnosis, end with the best that they have found (s); 0 for no end.", 0.0,
                LONGEST_BUDGET_S, read_only=False)
        self._run_limits = declare_run_limits(self)
        self._player = ActionCaller(self, PlayWaveform, "play_waveform")
        self._tracker = StageTracker(self)
        self._recorder = RecorderCaller(self)
        self._goals = GoalServers(self)
        self._goals.serve(RunExperiment, "identification/run_experiment", self._run_experiment)
        self._goals.serve(Identify, "identification/identify", self._identify)
        self._goals.serve(Diagnose, "identification/diagnose", self._diagnose)
        autostart(self)

    def wind_down(self) -> bool:
        """Cancel running goals; return whether they have ended."""
        return self._goals.end()

    def _run_experiment(self, goal: RunExperiment.Goal, result: RunExperiment.Result,
                        progress: Progress) -> None:
        def show(step: str, fraction: float) -> None:
            progress.report(fraction, stage=step)

        directory = self._writable(goal)
        stage = self._stage.wait(progress.check, several_axes=goal.experiment != NAME)
        if stage.axes:
            self._run_axes_experiments(goal, stage, directory, result, show, progress)
            return
        if goal.experiment == NAME:
            document = self._probe(stage, directory, result, show, progress, goal.unrecorded)
            result.recording = str(directory / NAME)
            result.summary = probe_file.probe_summary(document)
            return
        experiment = self._fitted(goal.experiment, stage, directory)
        result.summary = f"{experiment.description}, {experiment.duration_s:g} s"
        (note, recording), = self._record_each(
            [experiment], stage, directory, result, show, progress, goal.unrecorded)
        result.message = "; ".join(filter(None, (note, recording.note)))
        if isinstance(experiment, RelayExperiment) and not recording.failure:
            oscillation = relay_oscillation(read_recording(result.recording), experiment)
            result.summary += f"\n{oscillation.summary}"

    def _run_axes_experiments(self, goal: RunExperiment.Goal, stage: StageDescription,
                              directory: Path, result: RunExperiment.Result, show: Report,
                              progress: Progress) -> None:
        """Run the experiments of one name for all axes; record several in one folder."""
        experiments = axes_experiments(goal.experiment, {
            axis.name: _limits(stage, axis) for axis in stage.axes})
        if len(experiments) > 1:
            directory = self._data_root.writable(directory / free_name(directory, goal.experiment))
            _make(directory)
        result.summary = "\n".join(f"{each.description}, {each.duration_s:g} s"
                                   for each in experiments)
        runs = self._record_each(
            experiments, stage, directory, result, show, progress, goal.unrecorded)
        if len(experiments) > 1:
            result.recording = str(directory)
        result.message = "; ".join(filter(None, (
            text for note, recording in runs for text in (note, recording.note))))

    def _record_each(self, experiments: Sequence[Experiment | RelayExperiment],
                     stage: StageDescription, directory: Path,
                     result: RunExperiment.Result | Identify.Result, show: Report,
                     progress: Progress, unrecorded: bool) -> list[tuple[str, RunRecording]]:
        """Run and record experiments in turn; see `_record`."""
        whole_s, done_s = sum(each.duration_s for each in experiments), 0.0
        runs = []
        for experiment in experiments:
            def report(step: str, fraction: float,
                       experiment: Experiment | RelayExperiment = experiment,
                       done_s: float = done_s) -> None:
                show(f"{experiment.name}: {step}",
                     (done_s + fraction * experiment.duration_s) / whole_s)
            runs.append(self._record(
                experiment, stage, directory, result, report, progress, unrecorded))
            done_s += experiment.duration_s
        return runs

    def _fitted(self, name: str, stage: StageDescription,
                directory: Path) -> Experiment | RelayExperiment:
        """Return an experiment, fitted to the stage if the directory has the file of a probe."""
        limits, path = _limits(stage), directory / probe_file.NAME
        if not path.exists():
            return named_experiment(name, limits)
        probed = probe_file.load_probe(self._data_root.readable(str(path)))
        self.get_logger().info(f"experiment {name} is fitted by {path}")
        return named_experiment(name, probed.usable(limits), probed.fitted(name))

    def _probe(self, stage: StageDescription, directory: Path,
               result: RunExperiment.Result | Identify.Result, report: Report, progress: Progress,
               unrecorded: bool) -> probe_file.ProbeDocument:
        """Play and record the steps of a probe, and write its file into the directory."""
        path, limits = self._data_root.writable(directory / probe_file.NAME), _limits(stage)
        steps = self._data_root.writable(directory / NAME)
        _make(steps)
        probe, played_s = Probe(limits), 0.0
        while (step := probe.step) is not None:
            text, step_s = step.description, step.duration_s

            def show(phase: str, fraction: float, text: str = text, begin_s: float = played_s,
                     step_s: float = step_s) -> None:
                # The duration of the probe is unknown until it ends.
                done_s = begin_s + fraction * step_s
                report(f"{NAME}, {text}: {phase}", done_s / (done_s + probe.longest_s))
            _, recording = self._record(step, stage, steps, result, show, progress, unrecorded)
            if recording.failure:
                raise CallFailed(f"{recording.note}: a probe must be recorded, run it again")
            probe.take(read_recording(recording.path))
            played_s += step_s
        document = probe_file.probe_document(probe.findings, limits)
        probe_file.save_probe(path, document)
        return document

    def _record(self, experiment: Experiment | RelayExperiment, stage: StageDescription,
                directory: Path,
                result: RunExperiment.Result | Identify.Result | Diagnose.Result, report: Report,
                progress: Progress, unrecorded: bool) -> tuple[str, RunRecording]:
        """Run and record an experiment; the path of its recording is always put in the result.

        Returns a note on the run, and the recording.
        """
        self._stage.check_unchanged(stage)
        with self._recorder.record(directory, experiment.name, {
                "parameters.json": Attachment(_described(experiment, stage))},
                unrecorded) as recording:
            if hasattr(result, "recording"):
                result.recording = recording.path
            else:
                result.recordings.append(recording.path)
            if isinstance(experiment, RelayExperiment):
                note = self._relay(experiment, report, progress, recording)
            else:
                note = self._play(experiment, [axis.name for axis in stage.axes], report, progress,
                                  recording)
        progress.check()
        return note, recording

    def _play(self, experiment: Experiment, axes: list[str], report: Report, progress: Progress,
              recording: RunRecording) -> str:
        """Play a waveform on the stage and wait for its end."""
        try:
            played = self._player.run(
                PlayWaveform.Goal(voltage_v=experiment.voltage_v.ravel().tolist(), axes=axes,
                                  sample_period_s=experiment.sample_period_s,
                                  repeats=experiment.repeats,
                                  client=self.get_fully_qualified_name()),
                lambda feedback: report(feedback.stage, feedback.fraction),
                lambda: progress.cancelled or recording.must_stop)
        except GoalAborted as aborted:
            recording.last_sample = aborted.result.last_sample
            raise
        recording.last_sample = played.last_sample
        return ""

    def _relay(self, experiment: RelayExperiment, report: Report, progress: Progress,
               recording: RunRecording) -> str:
        """Act as a relay on the stage's blocks; return a note on the run."""
        run, account = RelayRun(experiment), RunAccount(
            **self._run_limits, answered=True, streamed=False)

        def take(block: SampleBlock) -> float:
            if run.fraction < 1.0:
                account.take(block.flags)
            return run.take(np.frombuffer(block.displacement_um))

        try:
            self._tracker.run(
                experiment.feedforward_v, np.empty(0), experiment.ticks, take, True,
                lambda: progress.cancelled or recording.must_stop,
                lambda: report("feedback", run.fraction))
        finally:
            recording.last_sample = self._tracker.last_sample
        if not (run.fraction == 1.0 or progress.cancelled or recording.must_stop):
            raise CallFailed(f"the stage stopped before the end: {self._tracker.why_ended()}")
        if account.failure and not (progress.cancelled or recording.must_stop):
            raise CallFailed(account.failure)
        return account.note

    def _identify(self, goal: Identify.Goal, result: Identify.Result,
                  progress: Progress) -> None:
        directory = self._writable(goal)
        _make(directory)
        given = [*map(self._data_root.readable, goal.recordings)]
        if goal.probe_first and given:
            raise ValueError("probe_first was asked for, and recordings are given: leave one out")
        if goal.probe_first:
            self._probe(self._stage.wait(progress.check), directory, result,
                        lambda step, _: progress.report(0.0, stage=step), progress,
                        goal.unrecorded)
            result.recordings = []
        result.recordings = given or self._run_all(
            directory, result, progress, goal.unrecorded)
        if len(result.recordings) != len(EXPERIMENTS):
            raise ValueError(
                f"{len(result.recordings)} recordings are named: give those of "
                f"{', '.join(EXPERIMENTS)}, in this order, or none")
        progress.check()
        recordings = dict(zip(EXPERIMENTS, map(read_recording, result.recordings), strict=True))
        for name, recording in recordings.items():
            for misfit in misfits(recording, name):
                self.get_logger().warning(misfit.sentence)
        try:
            identified = identify(
                creep=recordings["creep"], dynamics=recordings["dynamics"],
                hysteresis=recordings["hysteresis"], validation=recordings["validation"],
                refine=self._refine,
                order=ResponseOrder(goal.creep_pairs or None, goal.modes or None, None),
                progress=lambda stage, fraction: progress.report(
                    EXPERIMENTS_FRACTION + (1.0 - EXPERIMENTS_FRACTION) * fraction,
                    stage=f"estimate: {stage}"),
                cancelled=lambda: progress.cancelled, note=self.get_logger().info,
                budget=self._budget())
        except IdentificationCancelled:
            raise Cancelled from None
        model = directory / "model.json"
        kept = f"the earlier model is kept as {previous_of(model).name}" if model.exists() else ""
        save_model(model, identified)
        result.model = str(model)
        result.message = "; ".join(filter(None, (identified.unfinished, kept)))
        result.adequacy = overall_verdict(identified.adequacy)
        result.adequacy_json = json.dumps(identified.adequacy)
        result.error_names = list(identified.errors)
        result.error_values = [float(value) for value in identified.errors.values()]

    def _run_all(self, directory: Path, result: Identify.Result, progress: Progress,
                 unrecorded: bool) -> list[str]:
        """Run every experiment; raise CallFailed at the end if one could not be recorded."""
        stage = self._stage.wait(progress.check)
        runs = self._record_each(
            [self._fitted(name, stage, directory) for name in EXPERIMENTS], stage, directory,
            result, lambda step, fraction: progress.report(
                EXPERIMENTS_FRACTION * fraction, stage=step), progress, unrecorded)
        unread = [recording.note for _, recording in runs if recording.failure]
        if unread:
            raise CallFailed(f"{'; '.join(unread)}: run those experiments again, and give all "
                             "recordings to identify")
        return result.recordings

    def _diagnose(self, goal: Diagnose.Goal, result: Diagnose.Result,
                  progress: Progress) -> None:
        def report(stage: str, fraction: float) -> None:
            progress.check()
            progress.report(fraction, stage=stage)

        readable, directory = self._data_root.readable, self._writable(goal)
        for name in DIAGNOSIS_FILES:  # they may be links to other places
            self._data_root.writable(directory / name)
        files: DiagnosedFiles = (readable(goal.model), [*map(readable, goal.recordings)],
                                 readable(goal.holdout) or None, directory)
        if goal.experiments:
            results, result.decision = self._decide(files, goal, result, progress, report)
        else:
            results = diagnose_files(*files, report, budget=self._budget())
        diagnosis = results.diagnosis
        result.message = "; ".join(filter(None, (result.message, diagnosis.not_tried)))
        result.verdict = diagnosis.verdict
        result.sentence = verdict_sentence(diagnosis)
        result.effects = [entry["name"] for entry in diagnosis.effects]
        result.extended_model = str(results.extended_model)
        result.report = str(results.report)
        result.verdict_json = results.verdict.read_text(encoding="utf-8")
        for name in ("rms_um", "e_y_percent"):
            setattr(result, f"before_{name}", float(diagnosis.before[name]))
            setattr(result, f"after_{name}", float(diagnosis.after[name]))

    def _decide(self, files: DiagnosedFiles, goal: Diagnose.Goal, result: Diagnose.Result,
                progress: Progress, report: Report) -> tuple[DiagnosisResults, str]:
        """Diagnose, and play experiments that decide between the remaining explanations."""
        if not (np.isfinite(goal.longest_s) and goal.longest_s >= 0.0):
            raise ValueError(f"longest_s is {goal.longest_s:g}: give how long an experiment may "
                             "last in s, or 0")
        stage = self._stage.wait(progress.check)

        def play(experiment: Experiment, directory: Path, show: Report) -> str:
            note, _ = self._record(experiment, stage, self._data_root.writable(directory), result,
                                   show, progress, unrecorded=False)
            result.message = "; ".join(filter(None, (result.message, note)))
            return str(result.recordings[-1])

        results, steps = decide_files(
            *files, play, goal.experiments, _limits(stage), report, goal.longest_s or LONGEST_S,
            self._budget)
        return results, decision_sentence(steps)

    def _budget(self) -> Budget:
        """Return the time budget of a goal, which starts now."""
        return Budget(self.get_parameter(BUDGET).value or None)

    def _writable(self, goal: RunExperiment.Goal | Identify.Goal | Diagnose.Goal) -> Path:
        """Return the directory for the files of a goal."""
        return self._data_root.writable(goal.directory or self._directory)


def _limits(stage: StageDescription, axis: StageAxis | None = None) -> StageLimits:
    """Return the limits of a stage, or of one of its axes, for the design of experiments."""
    own = axis or stage
    return StageLimits(
        own.minimum_voltage_v, own.maximum_voltage_v, own.slew_limit_v_per_s,
        stage.sample_rate_hz, own.rest_voltage_v, stage.samples_per_tick,
        own.minimum_displacement_um, own.maximum_displacement_um)


def _described(experiment: Experiment | RelayExperiment, stage: StageDescription) -> str:
    return json.dumps({
        "experiment": experiment.name, "description": experiment.description,
        "duration_s": experiment.duration_s, **experiment.parameters(),
        "minimum_voltage_v": stage.minimum_voltage_v,
        "maximum_voltage_v": stage.maximum_voltage_v}, indent=1)


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{directory}: {error.strerror}; choose another directory") from None


def main(args: list[str] | None = None) -> None:
    """Run the node ``identification``."""
    run_node(IdentificationNode, args)
