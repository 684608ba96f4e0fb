# SPDX-License-Identifier: BSD-3-Clause
"""The demo: identify a simulated stage, track, find what the model lacks, track again, report.

A second part monitors a change and decides on a cause; see `piezo_studies.demo.operation`. It ends
with a scan, which is computed meanwhile; see `piezo_studies.demo.diagnosed_scan`.
"""

import json
import os
import random
import shlex
import signal
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState

from piezo_bringup.processes import Processes
from piezo_client.client import Client, GoalFailed
from piezo_common.picture_style import to_png
from piezo_common.progress_line import ProgressLine
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_studies.demo.demo_command import USUAL
from piezo_studies.demo.demo_plant import demo_plant
from piezo_studies.demo.demo_report import (
    SHOWN_EXPERIMENTS,
    draw_runs,
    render_report,
    report_sections,
)
from piezo_studies.demo.demo_session import RunningGoal, Session, rest
from piezo_studies.demo.diagnosed_scan import diagnosed_scan, format_scan, scan_section
from piezo_studies.demo.extended_model_section import ExtendedModel, draw_models
from piezo_studies.demo.operation import second_part, start_changing_stage
from piezo_studies.demo.operation_section import format_operation, operation_sections
from piezo_studies.demo.run_directory import claim_directory
from piezo_studies.demo.summary import (
    aligned,
    model_error_rows,
    summarise,
    summarise_run,
    table_rows,
    tracking_error_rows,
)
from piezo_studies.demo.tracked_run import read_tracked_run
from piezo_studies.demo.tracking_pictures import draw_errors

NODES = {
    "stage": {"timing": "lockstep", "autostart": True, "seed": 1},
    "recorder": {},
    "identification": {},
    "controller": {},
}
NODES_OF_EXPERIMENTS = ("stage", "recorder", "identification")
# Frequency in Hz and amplitude in um peak to peak of the thesis' trajectories.
TRAJECTORIES = ((40.0, 40.0), (100.0, 40.0), (500.0, 21.0), (1000.0, 10.25))
CENTRE_UM = 50.0
DURATION_S = 1.0
MODES = ("open_loop", "feedforward", "composite")
# Voltages before each run, one second each. They erase the past of the hysteresis and let most of
# the creep decay, so that every run begins in the state that the feedforward assumes.
REST_VOLTAGE_V = (-20.0, *[0.0] * 60)
START_TIMEOUT_S = 60.0
ALIVE_PERIOD_S = 1.0
# ROS domains from which one is chosen for the demo alone.
DOMAIN_IDS = range(1, 101)
FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130


class DemoFailed(RuntimeError):
    """The demo cannot continue; the message gives the reason and the log."""

    def __init__(self, message, log):
        super().__init__(f"{message}; see {log}")


class WatchfulClient(Client):
    """A client that does not wait for nodes that have ended."""

    def __init__(self, processes):
        super().__init__()
        self._processes = processes
        self._names: tuple[str, ...] = ()

    def wait_for_nodes(self, names):
        """Spin until these nodes are running, and monitor them from then on."""
        self._names = tuple(names)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self.spin_until(lambda: not self._absent(), ALIVE_PERIOD_S):
            self.check()
            if time.monotonic() > deadline:
                name = self._absent()[0]
                raise DemoFailed(f"{name} did not start within {START_TIMEOUT_S:g} s",
                                 self._processes.log(name))

    def check(self):
        """Raise DemoFailed if a node has ended."""
        for name in self._names:
            status = self._processes.process(name).poll()
            if status is not None:
                raise DemoFailed(f"{name} ended by itself with status {status}",
                                 self._processes.log(name))

    def stage_is_active(self):
        """Return whether the stage is active."""
        state = self.call(GetState, "stage/get_state").current_state
        return state.id == State.PRIMARY_STATE_ACTIVE

    def _absent(self):
        there = self.node.get_node_names()
        return [name for name in self._names if name not in there]


def run_demo(plant, directory, command, progress, show_summary, has_second_part=True):
    """Run the demo, and write recordings, models, reports and logs into its directory.

    `show_summary` is called with the summary of the first part after its report was written. For
    the second part see `operation` and `diagnosed_scan`. DemoFailed is raised if a node fails or
    ends.
    """
    begin_s = time.monotonic()
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().choice(DOMAIN_IDS))
    with (ThreadPoolExecutor(1) as background,
          Processes(directory / "logs", data_root=directory) as processes):
        progress.show("start the nodes", 0.0)
        for name in NODES_OF_EXPERIMENTS:
            parameters = {"plant": plant.plant} if name == "stage" else {}
            processes.start(name, {**NODES[name], **parameters})
        with WatchfulClient(processes) as client:
            client.wait_for_nodes(NODES_OF_EXPERIMENTS)
            processes.start("controller", NODES["controller"])  # it imports during the experiments
            if has_second_part:
                scanned = background.submit(diagnosed_scan, directory / "scan")
            identified = _identify(client, processes, plant, directory, progress)
            client.wait_for_nodes(NODES)
            recording = _record_diagnostic(client, processes, directory, progress)
            identified_s = time.monotonic()
            # The diagnosis runs while the stage tracks and while the runs are drawn. Its report is
            # written during the second tracking, which needs only the model.
            with _diagnosing(client, processes, identified, recording, directory,
                             progress) as diagnosing:
                tracks = [*_track_all(client, processes, identified.model, directory, progress)]
                tracked_s = time.monotonic()
                drawn = background.submit(_draw_runs, identified, tracks, directory)
                extended_model = directory / "diagnosis" / "extended_model.json"
                if not diagnosing.wait_until(extended_model.exists):
                    diagnosing.result()  # raises the failure
                diagnosed_s = time.monotonic()
                compared = background.submit(draw_models, identified.model, extended_model,
                                             _recording_of("validation", identified))
                runs_after = [
                    background.submit(read_tracked_run, track) for track in _track_all(
                        client, processes, extended_model, directory / "after", progress)]
                diagnosis = diagnosing.result()
            tracked_again_s = time.monotonic()
            session = Session(client, processes, NODES["stage"], REST_VOLTAGE_V,
                              client.stage_is_active, lambda step: progress.show(step, 1.0))
            if has_second_part:  # its nodes start while the report is drawn
                change_s = start_changing_stage(session, plant.plant, directory)
            progress.show("draw the report", 1.0)
            summary, sections = _report(
                plant, directory, drawn.result(), diagnosis, compared.result(),
                [run.result() for run in runs_after], command)
            summary["wall_s"] = {
                "identification": identified_s - begin_s,  # and the recording to be diagnosed
                "tracking": tracked_s - identified_s,
                "diagnosis": diagnosed_s - tracked_s,
                "tracking_after": tracked_again_s - diagnosed_s,
                "all": time.monotonic() - begin_s,
            }
            _write_summary(summary, directory)
            progress.clear()
            show_summary(summary)
            if has_second_part:
                begin_s = time.monotonic()
                with _blaming(processes, "identification"):
                    summary["operation"] = second_part(
                        session, plant.plant, change_s, diagnosis.extended_model, directory)
                summary["scan"] = scanned.result().summary
                summary["wall_s"]["second_part"] = time.monotonic() - begin_s
                _write_summary(summary, directory)
                _write_page(directory, plant, command,
                            [*sections, *operation_sections(summary["operation"]),
                             scan_section(scanned.result())])
        progress.show("end the nodes", 1.0)
    return summary


def _write_summary(summary, directory):
    (directory / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")


def _write_page(directory, plant, command, sections):
    (directory / "report.html").write_text(
        render_report(plant, command, sections), encoding="utf-8")


def _shown(progress, step):
    """Return a function that shows the feedback of an action."""
    return lambda feedback: progress.show(
        f"{step}, {feedback.stage}", feedback.fraction, feedback.seconds_left)


def _identify(client, processes, plant, directory, progress):
    """Identify, and bring the stage to rest during the estimation."""
    with _blaming(processes, "identification"):
        goal = RunningGoal(
            client, "identify", _shown(progress, "identify"), directory=directory)
        if goal.wait_until(lambda: goal.stage.startswith("estimate")):
            _rest(client, processes)
        return goal.result()


def _record_diagnostic(client, processes, directory, progress):
    """Run the diagnostic experiment, and return the path of its recording."""
    with _blaming(processes, "identification"):
        return client.run_experiment(
            "diagnostic", directory, on_feedback=_shown(progress, "diagnose")).recording


@contextmanager
def _diagnosing(client, processes, identified, recording, directory, progress):
    """Start the diagnosis, and yield its running goal."""
    with _blaming(processes, "identification"):
        yield RunningGoal(
            client, "diagnose", _shown(progress, "diagnose"), directory=directory / "diagnosis",
            model=identified.model, recordings=[recording],
            holdout=_recording_of("validation", identified))


def _rest(client, processes):
    with _blaming(processes, "stage"):
        rest(client, REST_VOLTAGE_V)


def _recording_of(experiment, identified):
    return next(path for path in map(Path, identified.recordings) if path.name == experiment)


def _track_all(client, processes, model, directory, progress):
    """Track every trajectory in every mode, and yield the path of each recording."""
    begin_s = time.monotonic()
    runs = [(*trajectory, mode) for trajectory in TRAJECTORIES for mode in MODES]
    for number, (frequency_hz, amplitude_um, mode) in enumerate(runs):
        def show(run_fraction, number=number, frequency_hz=frequency_hz, mode=mode):
            fraction = (number + run_fraction) / len(runs)
            taken_s = time.monotonic() - begin_s
            progress.show(f"track, {frequency_hz:g} Hz, {mode.replace('_', ' ')}", fraction,
                          taken_s * (1.0 / fraction - 1.0) if fraction else None)

        show(0.0)
        reference = {"kind": "harmonic", "frequency_hz": [frequency_hz],
                     "amplitude_um": [amplitude_um], "centre_um": CENTRE_UM}
        _rest(client, processes)
        with _blaming(processes, "controller"):
            run = client.track(
                reference, model, mode, DURATION_S, directory / f"{frequency_hz:g}_hz",
                on_feedback=lambda feedback, show=show: show(feedback.fraction))
        yield run.recording


def _draw_runs(identified, tracks, directory):
    errors = dict(zip(identified.error_names, identified.error_values, strict=True))
    return draw_runs(errors, identified.model, [
        _recording_of(name, identified) for name in SHOWN_EXPERIMENTS], tracks, directory)


def _report(plant, directory, drawn, diagnosis, compared, runs_after, command):
    """Write the report; return the summary, and the sections of the report."""
    verdict = json.loads(diagnosis.verdict_json)
    summary = {
        "plant": plant.name,
        **summarise(drawn.runs, drawn.errors, directory),
        "diagnosis": {key: verdict[key] for key in ("verdict", "effects", "before", "after")},
        "tracking_after": [summarise_run(run, directory) for run in runs_after],
    }
    extended = ExtendedModel(diagnosis.sentence, verdict, compared, runs_after)
    (directory / "tracking.png").write_bytes(to_png(
        draw_errors(summary["tracking"], summary["tracking_after"])))
    sections = report_sections(summary, drawn, extended)
    _write_page(directory, plant, command, sections)
    return summary, sections


@contextmanager
def _blaming(processes, name):
    """Convert the failure of an action into DemoFailed with the log of the node."""
    try:
        yield
    except GoalFailed as failure:
        raise DemoFailed(str(failure), processes.log(name)) from None


def run_given(options):
    """Run the demo with the given options, and print its results."""
    command = shlex.join(["./run", "piezo_studies", "demo",
                          *(["--plant", options.plant] if options.plant != USUAL else []),
                          *(["--output", str(options.output)] if options.output else []),
                          *(["--first-part"] if options.first_part else [])])
    try:
        plant = demo_plant(options.plant)
    except PlantConfigError as error:
        _fail(BAD_INPUT, error)
    directory = options.output or plant.directory
    for number in signal.SIGINT, signal.SIGTERM:
        signal.signal(number, _interrupt)
    progress = ProgressLine()
    try:
        earlier = claim_directory(directory, command)
    except ValueError as error:
        _fail(BAD_INPUT, error)
    if earlier:
        print(f"the earlier run is now in {earlier}")
    try:
        summary = run_demo(plant, directory.absolute(), command, progress, _print_results,
                           not options.first_part)
    except KeyboardInterrupt:
        progress.clear()
        _fail(INTERRUPTED, f"interrupted; all nodes have ended, the recordings are in {directory}")
    except DemoFailed as failure:
        progress.clear()
        _fail(FAILED, failure)
    except Exception as error:
        progress.clear()
        log = directory / "logs" / "demo.log"
        log.parent.mkdir(exist_ok=True)
        log.write_text(traceback.format_exc(), encoding="utf-8")
        _fail(FAILED, f"{error or type(error).__name__}; see {log}")
    progress.clear()
    if "operation" in summary:
        print(f"\n{format_operation(summary['operation'])}\n{format_scan(summary['scan'])}")
        print(f"the second part took {summary['wall_s']['second_part']:.0f} s")
    print(f"report: {directory / 'report.html'}")


def _print_results(summary):
    print(aligned(table_rows(summary)))
    errors = ", ".join(f"{name.removesuffix('_percent').replace('_', ' ')} {value:.3f} %"
                       for name, value in summary["identification"].items())
    print(f"model on unseen data: {errors}")
    effects = " and ".join(entry["name"] for entry in summary["diagnosis"]["effects"])
    print(f"\ndiagnosis: {summary['diagnosis']['verdict']}"
          f"{', the model lacks ' + effects if effects else ''}\n")
    print(f"{aligned(model_error_rows(summary))}\n\n{aligned(tracking_error_rows(summary))}\n")
    print(f"closed loop: {summary['lockstep_ratio']:.1f} simulated seconds a second; "
          f"the demo took {summary['wall_s']['all']:.0f} s", flush=True)


def _interrupt(*_):
    """Interrupt once; ignore further signals, so that the nodes can end in order."""
    for number in signal.SIGINT, signal.SIGTERM:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _fail(status, message):
    print(f"demo: {message}", file=sys.stderr)
    sys.exit(status)
