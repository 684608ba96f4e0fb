# SPDX-License-Identifier: BSD-3-Clause
"""`stage`: run experiments, identify, track and diagnose from the command line."""

import argparse
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from rclpy.utilities import remove_ros_args

from piezo_client.client import GoalFailed
from piezo_client.references import harmonic, triangle
from piezo_client.stage import Stage
from piezo_common.progress_line import ProgressLine

FAILED, INTERRUPTED = 1, 130
Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Run = Callable[[Stage, argparse.Namespace], list[str]]
"""Does what a command is for; returns the lines to print."""

SHAPES = {"harmonic": harmonic, "triangle": triangle}


def main(arguments: list[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        The command line's by default.

    Returns
    -------
    int
        Exit status: 0, 1 if the stage's nodes refuse or fail, 130 after Ctrl-C.
    """
    given = sys.argv if arguments is None else [sys.argv[0], *arguments]
    options = _parser().parse_args(remove_ros_args(given)[1:])  # which a launch file adds
    for number in signal.SIGINT, signal.SIGTERM:
        signal.signal(number, signal.default_int_handler)
    progress = ProgressLine()
    try:
        with Stage(options.namespace, progress.show) as stage:
            lines = options.run(stage, options)
    except GoalFailed as failure:
        progress.clear()
        print(f"stage: {failure}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        progress.clear()
        print("stage: interrupted; the goal was cancelled, the stage returns to rest",
              file=sys.stderr)
        return INTERRUPTED
    progress.clear()
    print("\n".join(lines))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="stage", description="Drive a stage whose nodes run; a line on stderr shows progress.")
    parser.add_argument("--namespace", default="", help="of the stage's nodes")
    commands = parser.add_subparsers(title="what to do", required=True, metavar="COMMAND")
    _add_experiment(commands)
    _add_probe(commands)
    _add_identify(commands)
    _add_track(commands)
    _add_diagnose(commands)
    for name, run, text in (
            ("settle", _settle, "go to the lowest voltage, then rest until the creep is over"),
            ("stop", _stop, "ramp to rest and stay there until reset"),
            ("reset", _reset, "release a latched stop")):
        commands.add_parser(name, help=text, description=text).set_defaults(run=run)
    return parser


def _add(commands: Commands, name: str, run: Run, text: str) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    parser.add_argument("--output", type=Path, metavar="DIR", required=True,
                        help="directory for what it makes")
    return parser


def _add_experiment(commands: Commands) -> None:
    parser = _add(commands, "experiment", _experiment, "run and record one experiment")
    parser.add_argument("experiment", metavar="NAME", help="creep, dynamics, multisine, relay, "
                        "hysteresis, validation or diagnostic")


def _add_probe(commands: Commands) -> None:
    _add(commands, "probe", _probe, "measure an unknown stage, and fit the experiments to it")


def _add_identify(commands: Commands) -> None:
    parser = _add(commands, "identify", _identify, "run all experiments and estimate the model")
    parser.add_argument("--recordings", type=Path, nargs=4, default=(),
                        metavar=("CREEP", "DYNAMICS", "HYSTERESIS", "VALIDATION"),
                        help="take these instead of running experiments")
    parser.add_argument("--probe-first", action="store_true",
                        help="measure the stage first and fit the experiments to it")


def _add_track(commands: Commands) -> None:
    parser = _add(commands, "track", _track, "track a periodic reference and record the run")
    parser.add_argument("--model", type=Path, required=True, help="model file")
    parser.add_argument("--mode", default="composite",
                        help="such as open_loop, feedforward or composite (default: %(default)s)")
    parser.add_argument("--file", type=Path, metavar="CSV",
                        help="reference: one period, time_s,displacement_um at the sample rate")
    parser.add_argument("--shape", choices=SHAPES, default="harmonic",
                        help="reference where no file is given (default: %(default)s)")
    for option, default, text in (
            ("--frequency-hz", 100.0, "of the reference"),
            ("--amplitude-um", 40.0, "of the reference, peak to peak"),
            ("--centre-um", 50.0, "mean displacement"),
            ("--duration-s", 1.0, "how long")):
        parser.add_argument(option, type=float, default=default, metavar="NUMBER",
                            help=f"{text} (default: %(default)s)")


def _add_diagnose(commands: Commands) -> None:
    parser = _add(commands, "diagnose", _diagnose, "find what a model lacks, and extend it")
    parser.add_argument("--model", type=Path, required=True, help="model file")
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="FILE",
                        help="recordings to explain")
    parser.add_argument("--holdout", type=Path, default="", metavar="FILE",
                        help="recording on which the errors are measured")


def _experiment(stage: Stage, options: argparse.Namespace) -> list[str]:
    experiment = stage.run_experiment(options.experiment, options.output)
    return [experiment.summary, f"recorded {experiment.path}"]


def _probe(stage: Stage, options: argparse.Namespace) -> list[str]:
    probed = stage.run_experiment("probe", options.output)
    return [probed.summary, f"recorded {probed.path}", f"written {options.output / 'probe.json'}"]


def _identify(stage: Stage, options: argparse.Namespace) -> list[str]:
    identification = stage.identify(
        options.output, options.recordings, probe_first=options.probe_first)
    return [*(f"{name} {value:.4g}" for name, value in identification.errors.items()),
            *(" ".join([name, part["verdict"], part.get("left", "")]).rstrip()
              for name, part in identification.components.items()),
            f"written {identification.path}"]


def _track(stage: Stage, options: argparse.Namespace) -> list[str]:
    reference = (
        {"kind": "file", "file": str(options.file)} if options.file else
        SHAPES[options.shape](options.frequency_hz, options.amplitude_um, options.centre_um))
    run = stage.track(reference, options.model, options.mode, options.duration_s, options.output)
    return [f"e_rms_percent {run.e_rms_percent:.4g}",
            f"largest_error_um {run.largest_error_um:.4g}",
            *filter(None, [run.message]), f"recorded {run.path}"]


def _diagnose(stage: Stage, options: argparse.Namespace) -> list[str]:
    diagnosis = stage.diagnose(options.model, options.data, options.output, options.holdout)
    return [f"{diagnosis.verdict}: {diagnosis.sentence}", f"written {diagnosis.report}"]


def _settle(stage: Stage, _: argparse.Namespace) -> list[str]:
    stage.settle()
    return ["the stage has settled"]


def _stop(stage: Stage, _: argparse.Namespace) -> list[str]:
    stage.emergency_stop()
    return ["the stage ramps to rest and stays there until reset"]


def _reset(stage: Stage, _: argparse.Namespace) -> list[str]:
    stage.reset()
    return ["the stage is released"]


if __name__ == "__main__":
    sys.exit(main())
