# SPDX-License-Identifier: BSD-3-Clause
"""How the offline commands run, and how they refuse what they cannot use."""

import argparse
import sys
from collections.abc import Callable, Sequence

BAD_INPUT = 2


def run_command(parser: argparse.ArgumentParser, work: Callable[[argparse.Namespace], object],
                arguments: Sequence[str] | None = None) -> int:
    """Run a command; input that cannot be used becomes one line on stderr.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    work : callable
        Called with the parsed options.
    arguments : list of str, optional
        The command line's by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for input that cannot be used.
    """
    options = parser.parse_args(arguments)
    try:
        work(options)
    except (ValueError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    return 0


def print_progress(stage: str, fraction: float) -> None:
    """Print which step a command is at, and which part of the whole is done (0 to 1)."""
    print(f"{100.0 * fraction:3.0f} %  {stage}", flush=True)
