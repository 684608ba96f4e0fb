# SPDX-License-Identifier: BSD-3-Clause
"""Options for frequency responses, which may include a zero-order hold."""

import argparse
import math

HELD = "zero-order-hold"
USUAL_RATE_HZ = 40000.0


def add_response_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--response`` and ``--response-rate-hz``."""
    parser.add_argument(
        "--response", choices=("continuous", HELD),
        help="what a frequency response is: that of the stage alone, between continuous signals "
        "(default); or that from voltage samples, each held until the next, to displacement "
        "samples")
    parser.add_argument(
        "--response-rate-hz", metavar="NUMBER", type=float,
        help=f"rate of such samples (default: {USUAL_RATE_HZ:g}, the stage's sample clock)")


def hold_s_of(options: argparse.Namespace) -> float:
    """Return the hold time included in a response, 0 if there is none, and print it.

    Parameters
    ----------
    options : argparse.Namespace
        Options of a parser with `add_response_options`.

    Raises
    ------
    ValueError
        If the rate does not apply to the response, or is not positive.
    """
    rate_hz = options.response_rate_hz
    if options.response != HELD:
        if rate_hz is not None:
            raise ValueError(f"--response-rate-hz has nothing to act on: give --response {HELD} "
                             "as well, or leave it out")
        return 0.0
    rate_hz = USUAL_RATE_HZ if rate_hz is None else rate_hz
    if not 0.0 < rate_hz < math.inf:
        raise ValueError(f"--response-rate-hz is {rate_hz:g}: give a positive rate")
    print(f"the frequency response is taken for one from samples held for {1e6 / rate_hz:.6g} us")
    return 1.0 / rate_hz


def useless_response_options(options: argparse.Namespace) -> dict[str, bool]:
    """Return for each option whether it was given; they apply only to frequency responses."""
    return {"--response": options.response is not None,
            "--response-rate-hz": options.response_rate_hz is not None}
