# SPDX-License-Identifier: BSD-3-Clause
"""Offline commands: options that are read without heavy imports, then the work itself."""

import argparse
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from piezo_common.budget import Budget

BAD_INPUT, INTERRUPTED, NO_READER = 2, 130, 141
UMBRELLA = "piezo"
"""The command with all offline commands as subcommands."""
OF_THE_STAGE = "piezo_client"
"""The package of the command that drives a stage, which is not part of `UMBRELLA`."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as other errors are."""

    def error(self, message: str) -> NoReturn:
        """Print the message, and exit."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; --help lists the options\n")


@dataclass(frozen=True)
class Command:
    """An offline command; invalid input is reported as one line on stderr.

    Its module imports only what is necessary to read options: the libraries of the work take
    seconds to import, and help or a mistyped option or path should not wait for them.
    """

    name: str
    description: str
    add_options: Callable[[argparse.ArgumentParser], None]

    work: str
    """``module:function``, imported and called with the parsed options. It returns the exit status,
    or None for 0."""
    epilog: str = ""

    inputs: tuple[str, ...] = ()
    """Names of the options that are input files."""
    folders: tuple[str, ...] = ()
    """Names of the options that are folders to write to, which need not exist."""
    check: Callable[[argparse.Namespace], None] | None = None
    """Raises ValueError for options that cannot be combined, before the work is imported."""
    interrupted: str = "nothing was written"
    """What remains after Ctrl-C, as a part of a sentence."""

    def parser(self) -> argparse.ArgumentParser:
        """Return the parser of the command under its own name."""
        return self.fill(Parser(prog=self.name))

    def fill(self, parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
        """Set up a parser, for example of a subcommand, for this command; return it."""
        parser.description, parser.epilog = self.description, self.epilog
        self.add_options(parser)
        parser.set_defaults(prog=parser.prog)
        return parser

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the command; return its exit status.

        It is that of the work, 2 for invalid input, 130 after Ctrl-C, and 141 if the output has no
        reader any more.
        """
        return self.carry_out(self.parser().parse_args(arguments))

    def carry_out(self, options: argparse.Namespace) -> int:
        """Do the work for parsed options of `fill`; return the exit status."""
        options.begun_s = time.monotonic()
        try:
            for path in self._paths(options, self.inputs):
                if not path.exists():
                    raise FileNotFoundError(f"{path} does not exist: check the path")
            for path in self._paths(options, self.folders):
                if path.exists() and not path.is_dir():
                    raise ValueError(f"{path} is a file, not a folder: name a folder to write to")
            if self.check:
                self.check(options)
            return self._load()(options) or 0
        except BrokenPipeError:
            # The reader of the output, such as head, has ended; Python must not flush again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return NO_READER
        except (ValueError, OSError) as error:
            file = getattr(error, "filename", None)
            reason = f"{file}: {error.strerror}" if isinstance(error, OSError) and file else error
            print(f"{options.prog}: {reason}", file=sys.stderr)
            return BAD_INPUT
        except KeyboardInterrupt:
            print(f"{options.prog}: interrupted; {self.interrupted}", file=sys.stderr)
            return INTERRUPTED

    def _paths(self, options: argparse.Namespace, names: Sequence[str]) -> Iterator[Path]:
        for name in names:
            given = getattr(options, name)
            yield from [] if given is None else given if isinstance(given, list) else [given]

    def _load(self) -> Callable[[argparse.Namespace], Any]:
        module, _, function = self.work.partition(":")
        return getattr(import_module(module), function)


def add_report_option(parser: argparse.ArgumentParser, where: str) -> None:
    """Add ``--no-report``, for work whose page is not needed; the help says where it goes."""
    parser.add_argument("--no-report", dest="report", action="store_false",
                        help=f"do not write the page, {where}")


def namespace(text: str) -> str:
    """Return the namespace of nodes from an argument, such as ``/left``; raise if it is none.

    Examples
    --------
    >>> namespace("/left")
    '/left'
    """
    if not re.fullmatch(r"/?|(/?[a-z_]\w*)(/[a-z_]\w*)*", text, re.ASCII | re.IGNORECASE):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no namespace: give letters, digits and _, no digit first, such as /left")
    return text


def count(text: str) -> int:
    """Return a whole number of 1 or more from an argument; raise if it is none.

    Examples
    --------
    >>> count("3")
    3
    """
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no count: give a whole number of 1 or more")
    return int(text)


def check_output_file(output: Path) -> None:
    """Raise ValueError, before the work, if a file cannot be written.

    It is a directory then, or its directory does not exist.
    """
    if output.is_dir():
        raise ValueError(f"{output} is a folder: name a file as --output")
    if not output.absolute().parent.is_dir():
        raise ValueError(f"{output} is no file in an existing directory: choose another --output")


def add_budget_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--budget``, the time that the work of a command may take."""
    parser.add_argument("--budget", metavar="SECONDS", type=float,
                        help="time that the command may take: it ends with the best result so far, "
                        "and reports what it has not tried; by default as long as it takes")


def budget_of(options: argparse.Namespace, to_write_s: float = 0.0) -> Budget:
    """Return the budget of the option ``--budget``, whose time began with the command.

    It reserves time in s for writing the results.
    """
    return Budget(options.budget, taken_s=time.monotonic() - options.begun_s,
                  to_write_s=to_write_s)


def write_report(path: Path, page: str) -> None:
    """Write the page of a command, an HTML text, and print its path."""
    path.write_text(page, encoding="utf-8")
    print(f"report: {path}")


def print_next(options: argparse.Namespace, package: str, name: str, *arguments: object) -> None:
    """Print the command that a user may enter next; see `next_line`."""
    print(next_line(options.prog, package, name, *arguments))


def next_line(prog: str, package: str, name: str, *arguments: object) -> str:
    """Return the line that suggests the next command, in the form of the present one.

    `prog` is the name of the present command; `package` and `name` are those of the next one. Its
    arguments that begin with ``<`` are placeholders.

    Examples
    --------
    >>> next_line("check", "piezo_identification", "identify", "--creep", "my creep.csv")
    "next: ./run piezo_identification identify --creep 'my creep.csv'"
    >>> next_line("piezo check", "piezo_identification", "identify", "--creep", "<FILE>")
    'next: piezo identify --creep <FILE>'
    >>> next_line("piezo design", "piezo_client", "stage", "reset")
    'next, where ROS 2 runs the stage: ros2 run piezo_client stage reset'
    """
    prefix, words = "next:", ["./run", package, name]
    if prog.startswith(f"{UMBRELLA} "):
        words = [UMBRELLA, name]
        if package == OF_THE_STAGE:
            prefix, words = "next, where ROS 2 runs the stage:", ["ros2", "run", package, name]
    typed = [word if word.startswith("<") else shlex.quote(word) for word in map(str, arguments)]
    return " ".join([prefix, *words, *typed])


def print_progress(stage: str, fraction: float) -> None:
    """Print the present step of a command and the fraction done (0 to 1) in percent."""
    print(f"{100.0 * fraction:3.0f} %  {stage}", flush=True)
