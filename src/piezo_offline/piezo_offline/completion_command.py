# SPDX-License-Identifier: BSD-3-Clause
"""`piezo completion`: the script by which a shell completes commands, options and files."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from piezo_common.command_line import Command

SHELLS = ("bash", "zsh")


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="shell that is to complete")


def print_completion(options: argparse.Namespace) -> None:
    """Print the script for the shell of the options."""
    import shtab

    from piezo_offline.piezo_command import parser

    whole = parser()
    for action in _actions(whole):
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(whole, options.shell))


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the actions of a parser and of its subcommands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)


COMMAND = Command(
    "completion", "Print the script that completes this command in a shell.", _add_options,
    "piezo_offline.completion_command:print_completion",
    epilog='bash: eval "$(piezo completion bash)". zsh: the same with zsh, behind compinit; put '
    "the line into ~/.bashrc or ~/.zshrc to keep it.")
