# SPDX-License-Identifier: BSD-3-Clause
"""A stage to drive from a script or a notebook: each call waits for its end."""

import array
import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from piezo_interfaces.action import PlayWaveform
from piezo_interfaces.msg import StageDescription
from piezo_interfaces.srv import StartRecording, StopRecording
from std_srvs.srv import Trigger

from piezo_client.client import SERVER_TIMEOUT_S, Client, GoalFailed
from piezo_client.model_offers import LATCHED_S, accept_extended_model, offered_model
from piezo_client.paths import AnyPath
from piezo_client.results import (
    Diagnosis,
    Experiment,
    Identification,
    OfferedModel,
    Played,
    Tracking,
)
from piezo_client.scans import MAX_FEEDBACK_V, Scanned, scanned
from piezo_controller.axes.stored_scan import StoredScan, read_scan, write_scan
from piezo_ros.messages import Message, MessageType
from piezo_ros.stage_runs.described_stage import DescribedStage
from piezo_ros.stage_runs.recording_calls import RecorderNews, free_name

if TYPE_CHECKING:
    from piezo_client.scan_follower import ScanFollower
    from piezo_models.axes.coupled import CoupledModel

_numbers = itertools.count(1)

LEARNED = "learned"
"""Folder for the learned voltages."""


class Stage:
    """The nodes of one stage, driven by blocking calls of its `client`; a context manager.

    Every call raises `piezo_client.client.GoalFailed` if it is rejected or fails, with the message
    of the node, and leaves the stage at rest. Ctrl-C also leaves it at rest.

    Parameters
    ----------
    progress : callable, optional
        Called as ``progress(step, fraction, seconds_left)`` while something runs; for example
        ``ProgressLine().show``.
    wait_s : float
        Time to look for any of the nodes in s.
    """

    def __init__(self, namespace: str = "",
                 progress: Callable[[str, float, float], object] | None = None,
                 wait_s: float = SERVER_TIMEOUT_S) -> None:
        # The name is unique, as the stage stops when the node of this name is gone.
        self.client = Client(namespace, f"client_{os.getpid()}_{next(_numbers)}", wait_s)
        self._name = self.client.node.get_fully_qualified_name()
        self._news = RecorderNews(self.client.node)
        self._stage = DescribedStage(self.client.node)
        self._progress = progress
        self._follower: ScanFollower | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave ROS; the nodes keep running."""
        self.client.close()

    @property
    def description(self) -> StageDescription:
        """Limits, clock and rates that the stage publishes."""
        return self.client.description(self._stage)

    def play(self, voltage_v: ArrayLike, sample_period_s: float | None = None, repeats: int = 1,
             directory: AnyPath = "runs", name: str = "waveform", axes: Sequence[str] = (),
             marks: ArrayLike = (), attachments: Mapping[str, str] | None = None) -> Played:
        """Play a voltage and record it; stop if the recording fails.

        Parameters
        ----------
        voltage_v : array_like, shape (N,) or (N, axes)
        sample_period_s : float, optional
            A whole multiple of the stage's sample period, at most 1 s; by default that period.
        directory : path-like
            Folder for the recording.
        name : str
            Name of the recording; a number is added if it is already used.
        axes : sequence of str
            Names of the columns, if there are several; by default all axes of the stage.
        marks : array_like of uint8, shape (N,)
            Bits of `piezo_interfaces.msg.Marks` for each sample, if any has one.
        attachments : dict of str to str
            Texts to keep in the recording, by the names of their files.
        """
        if sample_period_s is None:
            sample_period_s = 1.0 / self.description.sample_rate_hz
        period_s, texts = sample_period_s, attachments or {}
        return self._record(directory, name, lambda why_stop: self._play(
            "", voltage_v, period_s, repeats, why_stop, axes, marks).last_sample, texts)

    def scan(self, scan: AnyPath | StoredScan, periods: int = 2, directory: AnyPath = "runs",
             name: str = "scan", feedback: AnyPath | None = None,
             max_feedback_v: float = MAX_FEEDBACK_V) -> Scanned:
        """Play and record a path that `scan` has planned, and compare its last period.

        Parameters
        ----------
        scan : path-like or StoredScan
            Folder that `scan` wrote its voltages into, or the voltages.
        periods : int
            Periods to play; the first ones let the motion settle.
        directory : path-like
            Folder for the recording.
        name : str
            Name of the recording; a number is added if it is already used.
        feedback : path-like, optional
            Law file that `design` wrote for the model of the scan: the stage then adds its feedback
            to the planned voltages, from the first period on.
        max_feedback_v : float
            Largest voltage of the feedback of each axis, of either sign (V).
        """
        planned = _voltages(scan)
        if feedback is None:
            return self._scan(planned, periods, directory, name)
        return self._scan_with_feedback(planned, feedback, periods, directory, name,
                                        max_feedback_v)

    def learn_scan(self, scan: AnyPath | StoredScan, model: "AnyPath | CoupledModel", runs: int = 6,
                   periods: int = 2, directory: AnyPath = "runs",
                   name: str = "scan") -> list[Scanned]:
        """Play a planned path repeatedly, each time with voltages learned from the last run.

        It ends early if a run is not better than the one before. The voltages of the best run are
        written into the folder ``learned``, from which `scan` can play them.

        Parameters
        ----------
        scan, periods, directory, name
            As for `scan`.
        model : path-like or CoupledModel
            Model of the axes, at the sample period of the scan.
        runs : int
            Largest number of runs.

        Returns
        -------
        list of Scanned
            The runs in their order.
        """
        # Imported here, since it takes a second that playing alone does not need.
        from piezo_client.scan_learning import learned
        from piezo_models.axes.coupled import CoupledModel
        from piezo_models.axes_model_file import load_axes_model

        coupled = model if isinstance(model, CoupledModel) else load_axes_model(model).model
        planned, done = _voltages(scan), []
        for _ in range(runs):
            done.append(self._scan(planned, periods, directory, name))
            worst = [max(run.error_percent) for run in done[-2:]]
            if worst[-1] > worst[0]:
                break
            planned = learned(done[-1], coupled)
        best = min(done, key=lambda run: max(run.error_percent))
        write_scan(best.scan, Path(directory) / free_name(directory, LEARNED))
        return done

    def _scan(self, planned: StoredScan, periods: int, directory: AnyPath, name: str) -> Scanned:
        played = self.play(planned.repeated_v(periods), planned.sample_period_s,
                           directory=directory, name=name, axes=planned.axes,
                           marks=planned.repeated_marks(periods),
                           attachments=planned.attachments)
        return scanned(planned, played, periods)

    def _scan_with_feedback(self, planned: StoredScan, feedback: AnyPath, periods: int,
                            directory: AnyPath, name: str, max_feedback_v: float) -> Scanned:
        # Imported here, since it takes a second that playing alone does not need.
        from piezo_client.scan_follower import ScanFollower
        from piezo_controller.axes.followed_scan import AxesStage, followed_scan
        from piezo_models.feedback_law.axes_law import load_axes_law

        run = followed_scan(planned, AxesStage.of(self.description),
                            periods * len(planned.voltage_v), load_axes_law(feedback),
                            max_feedback_v)
        follower = self._follower = self._follower or ScanFollower(self.client)
        played = self._record(directory, name, lambda why_stop: follower.follow(
            run, why_stop, self._progress), planned.attachments)
        return scanned(planned, played, periods, len(run.once_voltage_v))

    def _record(self, directory: AnyPath, name: str,
                run: Callable[[Callable[[], str]], int],
                attachments: Mapping[str, str]) -> Played:
        """Record a run, which takes why it must stop, and returns its last sample."""
        path = self._call("recorder/start_recording", StartRecording,
                          directory=directory, name=free_name(directory, name),
                          attachment_names=list(attachments),
                          attachment_contents=list(attachments.values()),
                          client=self._name).path
        recording, last_sample = self._news.about(path), 0
        try:
            last_sample = run(lambda: recording.failure)
        finally:
            if not recording.failure:
                self._call("recorder/stop_recording", StopRecording, last_sample=last_sample,
                           client=self._name)
        return Played(Path(path))

    def settle(self, lowest_voltage_v: float | None = None, rest_s: int = 60) -> None:
        """Remove the past: go to the lowest voltage, then rest until creep is over.

        Parameters
        ----------
        lowest_voltage_v : float, optional
            Voltage in V for all axes; the lowest that the stage allows by default.
        rest_s : int
            Time at rest in seconds of the stage's time.
        """
        stage = self.description
        ends_v = np.array([(axis.minimum_voltage_v if lowest_voltage_v is None
                            else lowest_voltage_v, axis.rest_voltage_v)
                           for axis in stage.axes or [stage]])
        voltage_v = np.repeat(ends_v.T, (1, rest_s), axis=0)
        self._play("settle, ", voltage_v if stage.axes else voltage_v[:, 0], 1.0)

    def run_experiment(self, name: str, directory: AnyPath = "") -> Experiment:
        """Run and record one experiment.

        Parameters
        ----------
        name : str
            One of creep, dynamics, multisine, relay, hysteresis, validation, diagnostic and probe.
        directory : path-like
            Folder for the recording; by default that of the node's parameter.
        """
        result = self.client.run_experiment(name, directory, on_feedback=self._shown(""))
        return Experiment(Path(result.recording), result.summary)

    def identify(self, directory: AnyPath = "", recordings: Sequence[AnyPath] = (),
                 creep_pairs: int = 0, modes: int = 0,
                 probe_first: bool = False) -> Identification:
        """Run all experiments, or use these recordings, and estimate the model.

        Parameters
        ----------
        directory : path-like
            Folder for recordings and model; by default that of the node's parameter.
        recordings : sequence of path-like
            Recordings of creep, dynamics, hysteresis and validation, in this order.
        creep_pairs, modes : int
            Orders of the model; 0 to choose them from the data.
        probe_first : bool
            True to measure the stage first, and adapt the experiments to it.
        """
        result = self.client.identify(
            directory, recordings=recordings, creep_pairs=creep_pairs, modes=modes,
            probe_first=probe_first, on_feedback=self._shown(""))
        return Identification(
            Path(result.model), dict(zip(result.error_names, result.error_values, strict=True)),
            tuple(map(Path, result.recordings)), result.adequacy,
            json.loads(result.adequacy_json or "{}"), result.message)

    def track(self, reference: Mapping[str, Any], model: AnyPath, mode: str = "composite",
              duration_s: float = 1.0, directory: AnyPath = "",
              controller: AnyPath = "") -> Tracking:
        """Track a reference and record the run.

        Parameters
        ----------
        reference : dict
            Reference from `piezo_client.references`.
        model : path-like
            Model file, or the result of `identify` or `diagnose`.
        mode : str
            Mode of the action ``controller/track``.
        duration_s : float
            Duration of the tracking in s, without the way to the beginning and back.
        directory : path-like
            Folder for the recording; by default that of the node's parameter.
        controller : path-like
            File written by ``design``, for the composite modes; by default that of the node.
        """
        result = self.client.track(
            reference, model, mode, duration_s, directory, controller=controller,
            on_feedback=self._shown(f"track, {mode}: "))
        return Tracking(Path(result.recording), result.e_rms_percent, result.largest_error_um,
                        result.missed_feedback, result.message)

    def diagnose(self, model: AnyPath, recordings: Sequence[AnyPath], directory: AnyPath,
                 holdout: AnyPath = "", experiments: int = 0,
                 longest_s: float = 0.0) -> Diagnosis:
        """Find what a model lacks to explain recordings, and extend it accordingly.

        Parameters
        ----------
        model : path-like
            Model file, or the result of `identify`.
        recordings : sequence of path-like
            Recordings, or results of the calls that record.
        directory : path-like
            Folder for ``verdict.json``, ``extended_model.json`` and ``report.html``.
        holdout : path-like
            Recording on which the errors are measured; by default a part of the others.
        experiments : int
            Most experiments that the stage may play until one explanation has a probability of 95
            %.
        longest_s : float
            Longest duration of each of them in s; 0 for 30 s.
        """
        result = self.client.diagnose(
            model, recordings, directory, holdout, on_feedback=self._shown("diagnose: "),
            experiments=experiments, longest_s=float(longest_s))
        return Diagnosis(result.verdict, result.sentence, tuple(result.effects),
                         Path(result.extended_model), Path(result.report),
                         json.loads(result.verdict_json), result.decision,
                         tuple(map(Path, result.recordings)))

    def offered_model(self, wait_s: float = LATCHED_S) -> OfferedModel | None:
        """Return the last extended model that the monitor has offered within a time (s), if any."""
        return offered_model(self.client, wait_s)

    def accept_extended_model(self, model: AnyPath, extended_model: AnyPath = "") -> str:
        """Make runs that name a model use an extended one, from now on.

        Parameters
        ----------
        model : path-like
            Model that goals name.
        extended_model : path-like
            Model file, or the result of `offered_model` or `diagnose`; by default runs use the
            model itself again.

        Returns
        -------
        str
            Description of what is used from now on.
        """
        return accept_extended_model(self.client, model, extended_model)

    def emergency_stop(self) -> None:
        """Ramp to the rest voltage and stay there until `reset`."""
        self._call("emergency_stop", Trigger)

    def reset(self) -> None:
        """Release a latched stop."""
        self._call("reset", Trigger)

    def _play(self, step: str, voltage_v: ArrayLike, sample_period_s: float, repeats: int = 1,
              why_stop: Callable[[], str] | None = None, axes: Sequence[str] = (),
              marks: ArrayLike = ()) -> PlayWaveform.Result:
        if np.ndim(voltage_v) > 1 and not axes:
            axes = [axis.name for axis in self.description.axes]
            if np.shape(voltage_v)[1:] != (len(axes),):
                raise ValueError(f"voltage_v has the shape {np.shape(voltage_v)}, the stage the "
                                 f"axes {', '.join(axes) or '(one without a name)'}: give a column "
                                 "for each")
        return self.client.goal(
            "play_waveform", self._shown(step), why_stop=why_stop,
            sample_period_s=float(sample_period_s),
            voltage_v=_doubles(voltage_v), repeats=repeats, axes=list(axes),
            marks=array.array("B", np.asarray(marks, dtype=np.uint8).tobytes()))

    def _call(self, name: str, service_type: MessageType, /, **fields: Any) -> Message:
        response = self.client.call(service_type, name, **fields)
        if not response.success:
            raise GoalFailed(name, response)
        return response

    def _shown(self, step: str) -> Callable[[Message], object] | None:
        """Return a callback that passes feedback to the progress function; None without one."""
        progress = self._progress
        return progress and (lambda feedback: progress(
            step + getattr(feedback, "stage", ""), feedback.fraction, feedback.seconds_left))


def _voltages(scan: AnyPath | StoredScan) -> StoredScan:
    return scan if isinstance(scan, StoredScan) else read_scan(scan)


def _doubles(values: ArrayLike) -> array.array:
    return array.array("d", np.asarray(values, dtype=float).tobytes())
