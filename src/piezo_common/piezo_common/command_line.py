# SPDX-License-Identifier: BSD-3-Clause
"""How the offline commands run, and how they refuse what they cannot use."""

import sys

BAD_INPUT = 2


def run_command(parser, work, arguments=None):
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


def print_progress(stage, fraction):
    """Tell how far a command is: what it works at, and what part of all is done."""
    print(f"{100.0 * fraction:3.0f} %  {stage}", flush=True)
