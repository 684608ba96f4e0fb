# SPDX-License-Identifier: BSD-3-Clause
"""Start the process of a node so that Ctrl-C is quiet from its first moment on."""

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
    """Return what the executable of a node calls.

    Importing a node takes seconds, in which nothing runs yet that had to be ended in order. A
    signal then ends the process at once with one line. The node, once it is made, ends in order.
    Help, and what is no argument of a node, are answered before the import.

    Parameters
    ----------
    module : str
        Full name of the node's module, whose function ``main`` runs the node.
    description : str
        What the node does, a sentence.
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
    """Return the arguments that stand outside of every ``--ros-args ... --``."""
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
    """Tell whether arguments, or a parameter file that they name, give a parameter this value.

    For what must be known before there is a node. It does not look for which node they give it.

    Parameters
    ----------
    name, value : str
        Of the parameter.
    arguments : sequence of str
        Of the command line.
    """
    files = [Path(file) for option, file in pairwise(arguments) if option == "--params-file"]
    texts = [file.read_text("utf-8", "replace") for file in files if file.is_file()]
    return any(re.search(rf"\b{name}:=?\s*['\"]?{value}\b", text) for text in (*arguments, *texts))


def _leave(number: int, frame: FrameType | None) -> None:
    # Neither an exception, which an import may swallow or tell as its own, nor what Python does
    # at its end: what is half imported may fail there.
    name = Path(sys.argv[0]).name
    os.write(sys.stderr.fileno(), f"{name}: interrupted while it started\n".encode())
    os._exit(INTERRUPTED_STATUS)
