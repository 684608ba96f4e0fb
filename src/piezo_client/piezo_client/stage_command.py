# SPDX-License-Identifier: BSD-3-Clause
"""`stage`: run experiments, identify, track and diagnose from the command line."""

import argparse
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import NoReturn, TypeAlias

from piezo_common.command_line import BAD_INPUT, INTERRUPTED, Parser, count, namespace
from piezo_controller.commands.scan_command import WITHOUT_FILE, add_path_options
from piezo_ros.starting import without_ros_arguments

WAIT_S = 3.0
"""Time in s to look for nodes; running ones are visible within a second."""
Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"
INPUTS = ("model", "file", "waveform", "scan", "controller", "feedback", "data", "holdout",
          "recordings", "extended_model", "specimen")
SHAPES = "harmonic", "triangle"
DRAWN = {"shape": SHAPES[0], "frequency_hz": 100.0, "amplitude_um": 40.0, "centre_um": 50.0,
         "lines": 64}
"""Options that draw a reference, and their defaults."""
IDENTIFY = "`./run piezo_client stage identify --output DIR`"


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return 1 if a node of the stage rejects or fails, 2 for invalid input.

    The status is 130 after Ctrl-C, else 0.
    """
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(without_ros_arguments(given))  # a launch file adds these
    for path in _inputs(options):
        if not path.exists():
            print(f"stage: {path} does not exist: check the path", file=sys.stderr)
            return BAD_INPUT
    try:
        work = import_module("piezo_client.stage_work")
    except KeyboardInterrupt:
        print("stage: interrupted; nothing had begun", file=sys.stderr)
        return INTERRUPTED
    return work.drive(options)


def _inputs(options: argparse.Namespace) -> Iterator[Path]:
    for given in filter(None, (getattr(options, name, None) for name in INPUTS)):
        yield from given if isinstance(given, list) else [given]


class _Parser(Parser):
    """A parser whose error names the command that makes a model, if none is given."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, and exit."""
        needs_model = "required" in message and "--model" in message
        super().error(message + (
            f"; identify makes a model: {IDENTIFY}" if needs_model else ""))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="stage", description="Drive a stage whose nodes run; a line on stderr shows progress.")
    parser.add_argument("--namespace", default="", type=namespace,
                        help="of the stage's nodes")
    parser.add_argument("--wait-s", type=float, default=WAIT_S, metavar="NUMBER",
                        help="how long to look for any of these nodes (default: %(default)g)")
    commands = parser.add_subparsers(title="what to do", required=True, metavar="COMMAND",
                                     dest="command")
    for name, text in (
            ("list", "list the stages that can be seen, with their nodes"),
            ("status", "report the state of the stage, what runs on it, and its nodes")):
        commands.add_parser(name, help=text, description=text)
    _add_experiment(commands)
    _add_probe(commands)
    _add_identify(commands)
    _add_track(commands)
    _add_play(commands)
    _add_scan(commands)
    _add_diagnose(commands)
    _add_accept(commands)
    for name, text in (
            ("settle", "go to the lowest voltage, then rest until the creep is over"),
            ("stop", "ramp to rest and stay there until reset"),
            ("reset", "release a latched stop")):
        commands.add_parser(name, help=text, description=text)
    return parser


def _add(commands: Commands, name: str, text: str) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text)
    parser.add_argument("--output", type=Path, metavar="DIR", required=True,
                        help="directory for what it makes")
    return parser


def _add_experiment(commands: Commands) -> None:
    parser = _add(commands, "experiment", "run and record one experiment")
    parser.add_argument("experiment", metavar="NAME", help="creep, dynamics, multisine, relay, "
                        "hysteresis, validation, diagnostic or distortion")


def _add_probe(commands: Commands) -> None:
    _add(commands, "probe", "measure an unknown stage, and fit the experiments to it")


def _add_identify(commands: Commands) -> None:
    parser = _add(commands, "identify", "run all experiments and estimate the model")
    parser.add_argument("--recordings", type=Path, nargs=4, default=[],
                        metavar=("CREEP", "DYNAMICS", "HYSTERESIS", "VALIDATION"),
                        help="take these instead of running experiments")
    parser.add_argument("--probe-first", action="store_true",
                        help="measure the stage first and fit the experiments to it")


def _add_track(commands: Commands) -> None:
    parser = _add(commands, "track", "track a periodic reference, or a path of several axes, and "
                  "record the run")
    parser.add_argument("--model", type=Path, required=True, help="model file")
    parser.add_argument("--controller", type=Path, metavar="FILE",
                        help="feedback of the composite modes, as design wrote it; by default it "
                             "is designed for the model")
    parser.add_argument("--mode", default="composite",
                        help="such as open_loop, feedforward or composite (default: %(default)s)")
    parser.add_argument("--file", type=Path, metavar="CSV",
                        help="reference: one period, time_s,displacement_um at the sample rate; of "
                        "several axes x_displacement_um and so on, such as path.csv of scan")
    parser.add_argument("--shape", choices=(*SHAPES, *WITHOUT_FILE),
                        help=f"reference where no file is given (default: {DRAWN['shape']}); "
                        "shapes other than harmonic and triangle are paths of several axes, about "
                        "the operating point of the model")
    parser.add_argument("--lines", type=count, metavar="NUMBER",
                        help="lines, turns or lobes of a path of several axes (default: "
                        f"{DRAWN['lines']})")
    for name, text in (
            ("frequency_hz", "of the reference; lines or turns a second of a path"),
            ("amplitude_um", "of the reference, peak to peak; size of a path"),
            ("centre_um", "mean displacement")):
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, metavar="NUMBER",
                            help=f"{text} (default: {DRAWN[name]})")
    parser.add_argument("--duration-s", type=float, default=1.0, metavar="NUMBER",
                        help="how long (default: %(default)s)")


def _add_play(commands: Commands) -> None:
    parser = _add(commands, "play", "play a voltage of your own and record it")
    parser.add_argument("waveform", type=Path, metavar="FILE",
                        help="CSV time_s,voltage_v of uniform samples, or x_voltage_v and so on of "
                        "all axes; a recording as CSV will do")
    parser.add_argument("--repeats", type=count, default=1, metavar="NUMBER",
                        help="how often (default: %(default)s)")


def _add_scan(commands: Commands) -> None:
    parser = _add(commands, "scan", "play a path of several axes, report its error and make images")
    parser.add_argument("scan", type=Path, metavar="DIR", nargs="?",
                        help="folder that `scan` wrote path.csv and begin.csv into; or give "
                        "--pattern and --model")
    parser.add_argument("--periods", type=count, default=2, metavar="NUMBER",
                        help="how often it is followed; the last one counts (default: %(default)s)")
    parser.add_argument("--learn", type=count, default=0, metavar="RUNS",
                        help="play it so often at most, each time with voltages learned from the "
                        "run before")
    parser.add_argument("--model", type=Path, metavar="FILE",
                        help="model of the axes, to plan or to learn with")
    add_path_options(parser, None)
    parser.add_argument("--compare", action="store_true",
                        help="play the pattern without an inverse, too")
    parser.add_argument("--signal", default="", metavar="NAME",
                        help="detector of the images; the first one by default")
    parser.add_argument("--specimen", type=Path, metavar="FILE",
                        help="what the images show (.gsf), to tell their geometric error")
    parser.add_argument("--marks-by-position", action="store_true",
                        help="play it once more, with marks when the run before was at their "
                        "places")
    parser.add_argument("--feedback", type=Path, metavar="LAW",
                        help="law file of `design`: play it with this feedback, then without")


def _add_diagnose(commands: Commands) -> None:
    parser = _add(commands, "diagnose", "find what a model lacks, and extend it")
    parser.add_argument("--model", type=Path, required=True, help="model file")
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="FILE",
                        help="recordings to explain")
    parser.add_argument("--holdout", type=Path, default="", metavar="FILE",
                        help="recording on which the errors are measured")
    parser.add_argument("--experiments", type=count, default=0, metavar="NUMBER",
                        help="that may be played until one explanation remains (default: none)")
    parser.add_argument("--longest-s", type=float, default=0.0, metavar="SECONDS",
                        help="that each of them may last (default: 30 s)")


def _add_accept(commands: Commands) -> None:
    text = "let runs use an extended model in place of the one that they name"
    parser = commands.add_parser("accept", help=text, description=text)
    parser.add_argument("--model", type=Path, metavar="FILE",
                        help="that runs name; by default the one that the monitor's offer extends")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--extended-model", type=Path, metavar="FILE",
                       help="by default what the monitor offers")
    which.add_argument("--withdraw", action="store_true", help="use the model itself again")
