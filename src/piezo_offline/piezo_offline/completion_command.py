# SPDX-License-Identifier: BSD-3-Clause
"""`piezo completion`: the script by which a shell completes commands, options and files."""

import argparse

from piezo_common.command_line import Command

SHELLS = ("bash", "zsh")


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="shell that is to complete")


COMMAND = Command(
    "completion", "Print the script that completes this command in a shell.", _add_options,
    "piezo_offline.completion_work:print_completion",
    epilog='bash: eval "$(piezo completion bash)". zsh: the same with zsh, behind compinit; put '
    "the line into ~/.bashrc or ~/.zshrc to keep it.")
