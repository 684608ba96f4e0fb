# SPDX-License-Identifier: BSD-3-Clause
"""The work of the command `stage`: a function for each of its subcommands."""

import argparse
import json
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from piezo_client.client import GoalFailed
from piezo_client.overview import stages_seen, status_lines
from piezo_client.references import harmonic, path, triangle
from piezo_client.results import Tracking
from piezo_client.scans import Scanned, images_of
from piezo_client.stage import Stage
from piezo_client.stage_command import DRAWN
from piezo_common.command_line import BAD_INPUT, INTERRUPTED, next_line
from piezo_common.progress_line import ProgressLine
from piezo_common.text_file import read_bounded_text
from piezo_controller.axes.stored_scan import StoredScan, read_scan, stored_scan, write_scan
from piezo_models.model_summary import shortfall
from piezo_recorder.reading.waveform_file import read_waveform
from piezo_ros.stage_runs.recording_calls import free_name

FAILED = 1
MARKED = "marked"
"""Folder for the scan with marks by measured position."""
SHAPES = {"harmonic": harmonic, "triangle": triangle}


def drive(options: argparse.Namespace) -> int:
    """Execute a parsed command of `piezo_client.stage_command`; return the exit status."""
    for number in signal.SIGINT, signal.SIGTERM:
        signal.signal(number, signal.default_int_handler)
    progress = ProgressLine()
    shortfall = _shortfall(getattr(options, "model", None))
    if shortfall:
        print(shortfall, flush=True)
    try:
        with Stage(options.namespace, progress.show, options.wait_s) as stage:
            lines = WORK[options.command](stage, options)
    except (GoalFailed, ValueError, OSError) as failure:
        progress.clear()
        print(f"stage: {failure}", file=sys.stderr)
        return FAILED if isinstance(failure, GoalFailed) else BAD_INPUT
    except KeyboardInterrupt:
        progress.clear()
        print(f"stage: interrupted; {_what_stays(options)}", file=sys.stderr)
        return INTERRUPTED
    progress.clear()
    print("\n".join(lines))
    return 0


def _what_stays(options: argparse.Namespace) -> str:
    output = getattr(options, "output", None)
    if output is None and options.command != "settle":
        return "the nodes go on as they are"
    rest = "the goal was cancelled, the stage returns to rest"
    return rest if output is None else f"{rest}; what was recorded until then is in {output}"


def _next(options: argparse.Namespace, *arguments: object) -> str:
    """Return the line that suggests the next command."""
    return _next_of(options.namespace, *arguments)


def _next_of(namespace: str, *arguments: object) -> str:
    of_stage = ["--namespace", namespace] if namespace else []
    return next_line("stage", "piezo_client", "stage", *of_stage, *arguments)


def _check_of(recorded: Path) -> str:
    several = recorded.is_dir() and not (recorded / "metadata.yaml").exists()
    return next_line("stage", "piezo_identification", "check", "--data",
                     *(sorted(recorded.iterdir()) if several else [recorded]))


def _experiment(stage: Stage, options: argparse.Namespace) -> list[str]:
    experiment = stage.run_experiment(options.experiment, options.output)
    return [experiment.summary, f"recorded {experiment.path}",
            _check_of(experiment.path)]


def _probe(stage: Stage, options: argparse.Namespace) -> list[str]:
    probed = stage.run_experiment("probe", options.output)
    return [probed.summary, f"recorded {probed.path}", f"written {options.output / 'probe.json'}",
            _next(options, "identify", "--output", options.output)]


def _identify(stage: Stage, options: argparse.Namespace) -> list[str]:
    identification = stage.identify(
        options.output, options.recordings, probe_first=options.probe_first)
    return [*(f"{name} {value:.4g}" for name, value in identification.errors.items()),
            *(" ".join([name, part["verdict"], part.get("left", "")]).rstrip()
              for name, part in identification.components.items()),
            *filter(None, [identification.message]), f"written {identification.path}",
            _next(options, "settle"),
            _next(options, "track", "--model", identification.path, "--output", options.output)]


def _reference_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the reference that options describe; refuse those without effect on it."""
    given = {name: value for name in DRAWN if (value := getattr(options, name)) is not None}
    drawn: dict[str, Any] = DRAWN | given
    taken = {"shape", "frequency_hz", "amplitude_um",
             "centre_um" if drawn["shape"] in SHAPES else "lines"}
    ignored = [f"--{name.replace('_', '-')}" for name in given
               if options.file or name not in taken]
    if ignored:
        raise ValueError(f"the reference {options.file or drawn['shape']} does not depend on "
                         f"{', '.join(ignored)}: leave out what has no effect")
    if options.file:
        return {"kind": "file", "file": str(options.file)}
    numbers = drawn["frequency_hz"], drawn["amplitude_um"]
    if drawn["shape"] in SHAPES:
        return SHAPES[drawn["shape"]](*numbers, drawn["centre_um"])
    return path(drawn["shape"], *numbers, drawn["lines"])


def _track(stage: Stage, options: argparse.Namespace) -> list[str]:
    run = stage.track(_reference_of(options), options.model, options.mode, options.duration_s,
                      options.output, options.controller or "")
    return [f"e_rms_percent {run.e_rms_percent:.4g}",
            f"largest_error_um {run.largest_error_um:.4g}",
            *filter(None, [run.message]), f"recorded {run.path}", _diagnosis_of(run, options)]


def _diagnosis_of(run: Tracking, options: argparse.Namespace) -> str:
    # Imported here, since it takes seconds, which commands without a model can save.
    from piezo_models.model_file import is_of_several_axes

    arguments = ("--model", options.model, "--data", run.path, "--output",
                 options.output / "diagnosis")
    if is_of_several_axes(options.model):  # which the node does not diagnose
        return next_line("stage", "piezo_identification", "diagnose", *arguments)
    return _next(options, "diagnose", *arguments)


def _shortfall(model: Path | None) -> str:
    """Return what is unfinished or inadequate in a model; empty for a file that is not one."""
    if model is None:
        return ""
    # Imported here, since it takes seconds, which commands without a model can save.
    from piezo_models.model_file import LARGEST_FILE_BYTES

    try:
        document = json.loads(read_bounded_text(model, LARGEST_FILE_BYTES))
        return shortfall(document.get("adequacy", {}), document.get("errors", {}),
                         document.get("unfinished", ""))
    except (OSError, ValueError, LookupError, AttributeError, TypeError):
        return ""


def _play(stage: Stage, options: argparse.Namespace) -> list[str]:
    waveform = read_waveform(options.waveform)
    played = stage.play(waveform.voltage_v, waveform.sample_period_s, options.repeats,
                        options.output, options.waveform.stem, waveform.axes, waveform.marks)
    return [f"recorded {played.path}", _check_of(played.path)]


def _scan(stage: Stage, options: argparse.Namespace) -> list[str]:
    if (options.scan is None) == (options.pattern is None):
        raise ValueError("there is no path, or there are two: give a folder of `scan`, or "
                         "--pattern with --model")
    if options.scan is not None:
        _check_planned(options)
    if options.learn and options.model is None:
        raise ValueError("learning divides the error by the response of a model: give --model")
    if options.learn and options.feedback:
        raise ValueError("voltages are learned without feedback: leave out --learn or --feedback")
    scans = {"planned": read_scan(options.scan)} if options.pattern is None else _planned(options)
    planned = [(what, each, None) for what, each in scans.items()]
    *others, (name, scan, law) = planned if options.feedback is None else [
        *planned, (f"{planned[-1][0]} and feedback", planned[-1][1], options.feedback)]
    if options.marks_by_position:
        scan.checked_frame()  # before anything is played
    runs = (stage.learn_scan(scan, options.model, options.learn, options.periods, options.output)
            if options.learn else [stage.scan(scan, options.periods, options.output, feedback=law)])
    run = min(runs, key=lambda each: max(each.error_percent))
    if options.marks_by_position:
        run = _marked_by_position(stage, run, options)
    shown = {what: stage.scan(each, options.periods, options.output, what.replace(" ", "_"))
             for what, each, _ in others} | {name: run}
    return [*map(_errors_of, runs[:len(runs) if options.learn else 0]),
            *(line for what, each in shown.items() for line in (
                *([f"{what}:"] if len(shown) > 1 else []), str(each.summary()))),
            *(f"recorded {each.path}" for each in shown.values()),
            *_images(stage, shown, options),
            next_line("stage", "piezo_identification", "simulate", "--model",
                      options.model or "<MODEL>", "--data", run.path, "--output", options.output)]


def _check_planned(options: argparse.Namespace) -> None:
    """Raise ValueError if options would change a path that is planned already."""
    # Imported here, as it takes seconds that other commands do not need.
    from piezo_controller.commands.scan_command import OF_PATTERN
    from piezo_controller.commands.scan_work import OF_PLAN

    ignored = [f"--{name.replace('_', '-')}" for name in (*OF_PATTERN, *OF_PLAN, "compare")
               if getattr(options, name) not in (None, False)]
    if ignored:
        raise ValueError(f"{options.scan} is planned already: leave out {', '.join(ignored)}, or "
                         "plan again with --pattern and --model")


def _marked_by_position(stage: Stage, run: Scanned, options: argparse.Namespace) -> Scanned:
    """Play a scan again with marks by measured position, and keep these."""
    # Imported here, since SciPy takes as long as all that drives a stage.
    from piezo_client.scan_marks import marked

    scan = marked(run)
    write_scan(scan, options.output / free_name(options.output, MARKED))
    return stage.scan(scan, options.periods, options.output, feedback=options.feedback)


def _planned(options: argparse.Namespace) -> dict[str, StoredScan]:
    """Return the scans to play by what they are, the one of the inverse last."""
    # Imported here, as it takes seconds that other commands do not need.
    from piezo_controller.commands.scan_command import check_path_options
    from piezo_controller.commands.scan_work import plan_of

    if options.model is None:
        raise ValueError("a pattern is planned with a model of the axes: give --model")
    check_path_options(options)
    plan = plan_of(options)
    compared = {"no inverse": stored_scan(plan.without_inverse())} if options.compare else {}
    return compared | {"inverse": stored_scan(plan)}


def _images(stage: Stage, runs: Mapping[str, Scanned],
            options: argparse.Namespace) -> list[str]:
    """Make the images of runs, if a detector was recorded; return lines to print."""
    if not stage.description.signals or any(run.scan.frame is None for run in runs.values()):
        return []
    from piezo_common.gsf import read_gsf
    from piezo_recorder.images.image_page import write_images
    from piezo_recorder.reading.recording import RecordingError

    try:
        images = {name: image for what, run in runs.items()
                  for name, image in images_of(run, what, options.signal).items()}
    except RecordingError as reason:  # the runs are worth their results all the same
        return [f"no image: {reason}"]
    specimen = options.specimen and read_gsf(options.specimen)
    return write_images(images, options.output, specimen)


def _errors_of(run: Scanned) -> str:
    errors = (f"{axis} {percent:.4g} %" for axis, percent in zip(
        run.scan.axes, run.error_percent, strict=True))
    return f"{run.path.name}: error of {', '.join(errors)}"


def _diagnose(stage: Stage, options: argparse.Namespace) -> list[str]:
    diagnosis = stage.diagnose(options.model, options.data, options.output, options.holdout,
                               options.experiments, options.longest_s)
    return [f"{diagnosis.verdict}: {diagnosis.sentence}", *filter(None, [diagnosis.decision]),
            *(f"recorded {path}" for path in diagnosis.experiments), f"written {diagnosis.report}",
            _next(options, "track", "--model", diagnosis.path, "--output", options.output)]


def _accept(stage: Stage, options: argparse.Namespace) -> list[str]:
    offer = stage.offered_model()
    model = options.model or (offer and offer.model)
    extended = "" if options.withdraw else options.extended_model or offer
    if not model or extended is None:
        raise ValueError("the monitor offers no model: give --model and --extended-model, or look "
                         "at its diagnostics")
    sentences = [offer.sentence] if offer is not None and extended is offer else []
    return [*sentences, stage.accept_extended_model(model, extended),
            _next(options, "track", "--model", model, "--output", "<DIR>")]


def _settle(stage: Stage, options: argparse.Namespace) -> list[str]:
    stage.settle()
    return ["the stage has settled",
            _next(options, "track", "--model", "<MODEL>", "--output", "<DIR>")]


def _stop(stage: Stage, options: argparse.Namespace) -> list[str]:
    stage.emergency_stop()
    return ["the stage ramps to rest and stays there until reset", _next(options, "reset")]


def _reset(stage: Stage, options: argparse.Namespace) -> list[str]:
    stage.reset()
    return ["the stage is released", _next(options, "status")]


def _list(stage: Stage, options: argparse.Namespace) -> list[str]:
    seen = stages_seen(stage.client, options.wait_s)
    return [*(f"{namespace.rstrip('/')}/stage: {', '.join(sorted(seen[namespace]))}"
              for namespace in sorted(seen)),
            _next_of(min(seen).strip("/"), "status")]


def _status(stage: Stage, options: argparse.Namespace) -> list[str]:
    lines, is_stopped = status_lines(stage.client)
    following = ["reset"] if is_stopped else ["identify", "--output", "<DIR>"]
    return [*lines, _next(options, *following)]


WORK: dict[str, Callable[[Stage, argparse.Namespace], list[str]]] = {
    "list": _list, "status": _status, "experiment": _experiment, "probe": _probe,
    "identify": _identify, "track": _track, "play": _play, "scan": _scan,
    "diagnose": _diagnose, "accept": _accept,
    "settle": _settle, "stop": _stop, "reset": _reset}
"""For each subcommand, the function that does its work and returns the lines to print."""
