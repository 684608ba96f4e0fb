# SPDX-License-Identifier: BSD-3-Clause
"""`piezo`: work on recordings, models and controllers without ROS."""

import argparse
import sys
from importlib import metadata

from piezo_common.command_line import BAD_INPUT, UMBRELLA, Parser
from piezo_controller.commands.design_command import COMMAND as DESIGN
from piezo_controller.commands.scan_command import COMMAND as SCAN
from piezo_identification.commands.check_command import COMMAND as CHECK
from piezo_identification.commands.diagnose_command import COMMAND as DIAGNOSE
from piezo_identification.commands.diagnose_many_command import COMMAND as DIAGNOSE_MANY
from piezo_identification.commands.identify_command import COMMAND as IDENTIFY
from piezo_identification.commands.propose_command import COMMAND as PROPOSE
from piezo_identification.commands.simulate_command import COMMAND as SIMULATE
from piezo_identification.commands.waveforms_command import COMMAND as WAVEFORMS
from piezo_offline.completion_command import COMMAND as COMPLETION
from piezo_recorder.commands.convert_command import COMMAND as CONVERT
from piezo_recorder.commands.image_command import COMMAND as IMAGE
from piezo_recorder.commands.report_command import COMMAND as REPORT

COMMANDS = {command.name: command for command in (
    WAVEFORMS, CONVERT, REPORT, CHECK, IDENTIFY, SIMULATE, DIAGNOSE, DIAGNOSE_MANY, PROPOSE,
    DESIGN, SCAN, IMAGE, COMPLETION)}
"""Subcommands in the order of their use."""


class _Version(argparse.Action):
    """Print the version of the installed distribution, which is searched only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        distributions = metadata.packages_distributions()["piezo_offline"]
        print(f"{UMBRELLA} {metadata.version(distributions[0])}")
        parser.exit()


def main(arguments: list[str] | None = None) -> int:
    """Run the subcommand in the arguments.

    Return the exit status: that of the subcommand, 2 for invalid input, 130 after Ctrl-C.
    """
    given = sys.argv[1:] if arguments is None else arguments
    if not given:
        parser().print_help(sys.stderr)
        return BAD_INPUT
    options, unknown = parser().parse_known_args(given)
    if unknown:
        print(f"{options.prog}: {' '.join(unknown)} is no option of it: `{options.prog} --help` "
              "lists them", file=sys.stderr)
        return BAD_INPUT
    return COMMANDS[options.command].carry_out(options)


def parser() -> argparse.ArgumentParser:
    """Return the parser with all subcommands."""
    made = Parser(
        prog=UMBRELLA, description="Work on recordings, models and controllers of a piezo stage.")
    made.add_argument("--version", action=_Version, nargs=0, help="print the version, and end")
    commands = made.add_subparsers(title="commands", required=True, metavar="COMMAND",
                                   dest="command")
    for name, command in COMMANDS.items():
        command.fill(commands.add_parser(name, help=command.description))
    return made


if __name__ == "__main__":
    sys.exit(main())
