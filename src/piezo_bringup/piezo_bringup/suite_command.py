# SPDX-License-Identifier: BSD-3-Clause
"""`suite`: start the nodes of a stage in one terminal, like closed_loop.launch.py."""

import argparse
import signal
import sys
import time
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from piezo_bringup.processes import EXECUTABLES, USUAL_NODES, Processes
from piezo_common.command_line import namespace, next_line

POLL_S = 0.2
FAILED, BAD_INPUT = 1, 2


def main(arguments: list[str] | None = None) -> int:
    """Run the command.

    Returns
    -------
    int
        Exit status: 0 after Ctrl-C or SIGTERM, 1 if a node ended by itself, 2 for invalid input.
    """
    options = _parser().parse_args(arguments)
    if not options.parameters.is_file():
        print(f"suite: {options.parameters} is no file: give a parameter file (YAML)",
              file=sys.stderr)
        return BAD_INPUT
    if options.data_root and not options.data_root.is_dir():
        print(f"suite: {options.data_root} is no folder: give one that exists", file=sys.stderr)
        return BAD_INPUT
    ending: list[bool] = []
    for number in signal.SIGINT, signal.SIGTERM:
        signal.signal(number, lambda *_: ending.append(True))
    with (Processes(options.logs, data_root=options.data_root) as processes,
          closing(_watch(options)) as watch):
        for name in options.nodes:
            processes.start(name, namespace=options.namespace, parameter_file=options.parameters)
        print(f"{', '.join(options.nodes)} started; logs in {options.logs}; end them with Ctrl-C",
              flush=True)
        while not ending:
            next(watch)
            for name in options.nodes:
                if processes.process(name).poll() is not None:
                    print(f"suite: {name} ended by itself; see {processes.log(name)}",
                          file=sys.stderr)
                    return FAILED
        for name in reversed(options.nodes):
            print(f"ending {name}", flush=True)
            processes.stop([name])
        print("all nodes have ended", flush=True)
    return 0


def _watch(options: argparse.Namespace) -> Generator[None, None, None]:
    """Wait briefly at each step; once all nodes respond, say so and suggest a command."""
    # Importing its libraries takes a second, in which the nodes import theirs.
    from piezo_bringup.readiness import Readiness

    begun_s = time.monotonic()
    try:
        with Readiness(options.nodes, options.namespace) as nodes:
            while nodes.look(POLL_S):
                yield
    except RuntimeError as error:
        print(f"suite: whether the nodes are ready cannot be seen: {error}", file=sys.stderr)
    else:
        print(f"ready: every node answers, after {time.monotonic() - begun_s:.1f} s. In another "
              "terminal,", flush=True)
        of_stage = ["--namespace", options.namespace] if options.namespace else []
        following = (["identify", "--output", "runs/first"] if "identification" in options.nodes
                     else ["status"])
        print(next_line("suite", "piezo_client", "stage", *of_stage, *following), flush=True)
    while True:
        time.sleep(POLL_S)
        yield


def _parser() -> argparse.ArgumentParser:
    default = Path(get_package_share_directory("piezo_bringup"), "config", "simulated_stage.yaml")
    parser = argparse.ArgumentParser(
        prog="suite", description="Start the nodes of a simulated stage, and end them in order.")
    parser.add_argument("--nodes", nargs="+", choices=EXECUTABLES, default=list(USUAL_NODES),
                        metavar="NODE", help=f"some of {', '.join(EXECUTABLES)}; all but the last "
                                             "by default")
    parser.add_argument("--namespace", default="", type=namespace, metavar="/NAME",
                        help="of all nodes")
    parser.add_argument("--parameters", type=Path, default=default, metavar="FILE",
                        help="parameter file (YAML); that of the simulated stage by default")
    parser.add_argument("--data-root", type=Path, metavar="DIR",
                        help="folder under which the nodes write; by default that of the "
                             "parameter file, or the present one")
    parser.add_argument("--logs", type=Path, default=Path("runs/logs"), metavar="DIR",
                        help="gets what the nodes print (default: %(default)s)")
    return parser
