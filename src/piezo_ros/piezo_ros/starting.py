# SPDX-License-Identifier: BSD-3-Clause
"""Start the process of a node so that Ctrl-C never prints a traceback, even during the start."""

import argparse
import importlib
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from types import FrameType

INTERRUPTED_STATUS = 130


def node_entry(module: str, description: str) -> Callable[[list[str] | None], None]:
    """Return the main function of a node's executable, ``main`` of the module with this full name.

    Importing a node takes seconds in which nothing needs an orderly end, so a signal ends the
    process at once with one line. Once the node exists, it ends in order. Help and invalid
    arguments are handled before the import.
    """
    def main(args: list[str] | None = None) -> None:
        given = sys.argv[1:] if args is None else args
        _parser(module.rpartition(".")[2].removesuffix("_node"), description).parse_args(
            without_ros_arguments(given))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _leave)
        return importlib.import_module(module).main(args)

    main.__module__, main.__doc__ = module, description
    return main


def _parser(name: str, description: str) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog=name, description=description, usage=f"{name} [--ros-args -p NAME:=VALUE ...]",
        epilog="A node: its parameters are given as -p NAME:=VALUE or --params-file FILE, its "
        "namespace as -r __ns:=/NAME, behind --ros-args. It runs until Ctrl-C.")


def without_ros_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments outside of every ``--ros-args ... --``."""
    kept, of_ros = [], False
    for argument in arguments:
        if argument == "--ros-args":
            of_ros = True
        elif of_ros:
            of_ros = argument != "--"
        else:
            kept.append(argument)
    return kept


def arguments_set(name: str, value: str, arguments: Sequence[str]) -> bool:
    """Return True if arguments, or a parameter file that they name, set a parameter to this value.

    This is for parameters that are needed before there is a node. The name of the node is ignored.
    """
    files = [Path(file) for option, file in pairwise(arguments) if option == "--params-file"]
    texts = [file.read_text("utf-8", "replace") for file in files if file.is_file()]
    return any(re.search(rf"\b{name}:=?\s*['\"]?{value}\b", text) for text in (*arguments, *texts))


def _leave(number: int, frame: FrameType | None) -> None:
    # An exception could be swallowed by an import, and Python's normal exit could fail on modules
    # that are partly imported.
    name = Path(sys.argv[0]).name
    os.write(sys.stderr.fileno(), f"{name}: interrupted while it started\n".encode())
    os._exit(INTERRUPTED_STATUS)
