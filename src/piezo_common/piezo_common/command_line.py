# SPDX-License-Identifier: BSD-3-Clause
"""How the offline commands run: options that cost nothing to read, then the work behind them."""

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from piezo_common.budget import Budget

BAD_INPUT, INTERRUPTED, NO_READER = 2, 130, 141
UMBRELLA = "piezo"
"""The command that has all offline commands as its subcommands."""
OF_THE_STAGE = "piezo_client"
"""The package whose command drives a stage, which `UMBRELLA` cannot."""


@dataclass(frozen=True)
class Command:
    """An offline command; input that it cannot use becomes one line on stderr.

    The module that makes it imports nothing but what reads options: the libraries behind the work
    take seconds to import, and neither help nor a mistyped option or path has to wait for them.

    Attributes
    ----------
    add_options : callable
        Adds its options to a parser.
    work : str
        ``module:function``, imported and called with the parsed options. What it returns is the
        exit status, 0 if that is nothing.
    inputs : tuple of str
        Names of the options that are given files to read.
    check : callable, optional
        Raises ValueError for options that cannot be used together, before the work is imported.
    interrupted : str
        What Ctrl-C leaves behind, a part of a sentence.
    """

    name: str
    description: str
    add_options: Callable[[argparse.ArgumentParser], None]
    work: str
    epilog: str = ""
    inputs: tuple[str, ...] = ()
    check: Callable[[argparse.Namespace], None] | None = None
    interrupted: str = "nothing was written"

    def parser(self, prog: str = "") -> argparse.ArgumentParser:
        """Return the parser of the command when it is typed by its own name."""
        return self.fill(argparse.ArgumentParser(prog=prog or self.name))

    def fill(self, parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
        """Make a parser, such as that of a subcommand, the one of this command; return it."""
        parser.description, parser.epilog = self.description, self.epilog
        self.add_options(parser)
        parser.set_defaults(prog=parser.prog)
        return parser

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the command.

        Parameters
        ----------
        arguments : list of str, optional
            The command line's by default.

        Returns
        -------
        int
            Exit status: that of the work, 2 for input that cannot be used, 130 after Ctrl-C, 141
            where nobody reads the output any more.
        """
        return self.carry_out(self.parser().parse_args(arguments))

    def carry_out(self, options: argparse.Namespace) -> int:
        """Do the work for options that a parser of `fill` read; return the exit status."""
        options.begun_s = time.monotonic()
        try:
            for path in self._inputs(options):
                if not path.exists():
                    raise FileNotFoundError(f"{path} does not exist: check the path")
            if self.check:
                self.check(options)
            return self._load()(options) or 0
        except BrokenPipeError:
            # Whoever read the output, such as head, has seen enough; Python must not flush again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return NO_READER
        except (ValueError, OSError) as error:
            print(f"{options.prog}: {error}", file=sys.stderr)
            return BAD_INPUT
        except KeyboardInterrupt:
            print(f"{options.prog}: interrupted; {self.interrupted}", file=sys.stderr)
            return INTERRUPTED

    def _inputs(self, options: argparse.Namespace) -> Iterator[Path]:
        for name in self.inputs:
            given = getattr(options, name)
            yield from [] if given is None else given if isinstance(given, list) else [given]

    def _load(self) -> Callable[[argparse.Namespace], Any]:
        module, _, function = self.work.partition(":")
        return getattr(import_module(module), function)


def add_report_option(parser: argparse.ArgumentParser, where: str) -> None:
    """Add ``--no-report``, for work whose page nobody will look at.

    Parameters
    ----------
    where : str
        Where the page is written otherwise.
    """
    parser.add_argument("--no-report", dest="report", action="store_false",
                        help=f"do not write the page, {where}")


def check_output_file(output: Path) -> None:
    """Refuse a file that cannot be written, before the work.

    Raises
    ------
    ValueError
        If it is a directory, or in none that exists.
    """
    if output.is_dir() or not output.absolute().parent.is_dir():
        raise ValueError(f"{output} is no file in an existing directory: choose another --output")


def add_budget_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--budget``, the time that the work of a command may take."""
    parser.add_argument("--budget", metavar="SECONDS", type=float,
                        help="time that the command may take: it ends with the best result so far, "
                        "and says what it has not tried; by default as long as it takes")


def budget_of(options: argparse.Namespace, to_write_s: float = 0.0) -> Budget:
    """Return the time of the option ``--budget``, which began with the command.

    Parameters
    ----------
    to_write_s : float
        Time to keep for what is written in the end.
    """
    return Budget(options.budget, taken_s=time.monotonic() - options.begun_s,
                  to_write_s=to_write_s)


def write_report(path: Path, page: str) -> None:
    """Write the page of a command, and say where it is.

    Parameters
    ----------
    page : str
        HTML.
    """
    path.write_text(page, encoding="utf-8")
    print(f"report: {path}")


def print_next(options: argparse.Namespace, package: str, name: str, *arguments: object) -> None:
    """Print the command that a user may type next; see `next_line`.

    Parameters
    ----------
    options : argparse.Namespace
        Of a parser of `Command.fill`.
    """
    print(next_line(options.prog, package, name, *arguments))


def next_line(prog: str, package: str, name: str, *arguments: object) -> str:
    """Return the line with the command that a user may type next, as the present one was typed.

    Parameters
    ----------
    prog : str
        The present command.
    package, name : str
        Of the next command.
    *arguments
        Those that begin with ``<`` are for the user to fill in.

    Examples
    --------
    >>> next_line("check", "piezo_identification", "identify", "--creep", "my creep.csv")
    "next: ./run piezo_identification identify --creep 'my creep.csv'"
    >>> next_line("piezo check", "piezo_identification", "identify", "--creep", "<FILE>")
    'next: piezo identify --creep <FILE>'
    >>> next_line("piezo design", "piezo_client", "stage", "reset")
    'next, where ROS 2 runs the stage: ros2 run piezo_client stage reset'
    """
    said, words = "next:", ["./run", package, name]
    if prog.startswith(f"{UMBRELLA} "):
        words = [UMBRELLA, name]
        if package == OF_THE_STAGE:
            said, words = "next, where ROS 2 runs the stage:", ["ros2", "run", package, name]
    typed = [word if word.startswith("<") else shlex.quote(word) for word in map(str, arguments)]
    return " ".join([said, *words, *typed])


def print_progress(stage: str, fraction: float) -> None:
    """Print which step a command is at, and which part of the whole is done (0 to 1)."""
    print(f"{100.0 * fraction:3.0f} %  {stage}", flush=True)
