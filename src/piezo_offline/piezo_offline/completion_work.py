# SPDX-License-Identifier: BSD-3-Clause
"""The work of `piezo completion`: all subcommands with their options, and paths of inputs."""

import argparse
from collections.abc import Iterator
from pathlib import Path

import shtab


def print_completion(options: argparse.Namespace) -> None:
    """Print the script for the shell of the options."""
    from piezo_offline.piezo_command import parser

    print(script_for(options.shell, parser()))


def script_for(shell: str, parser: argparse.ArgumentParser) -> str:
    """Return the script by which a shell completes the arguments of a parser."""
    for action in _actions(parser):
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return shtab.complete(parser, shell)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the actions of a parser and of its subcommands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
