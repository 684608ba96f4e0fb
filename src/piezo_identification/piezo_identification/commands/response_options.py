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
        help=f"rate of such samples, and of the model of several axes (default: "
        f"{USUAL_RATE_HZ:g}, the stage's sample clock)")


def hold_s_of(options: argparse.Namespace) -> float:
    """Return the hold time included in a response, 0 if there is none, and print it.

    Raises
    ------
    ValueError
        If the rate does not apply to the response, or is not positive.
    """
    if options.response != HELD:
        if options.response_rate_hz is not None:
            raise ValueError(f"--response-rate-hz has nothing to act on: give --response {HELD} "
                             "as well, or leave it out")
        return 0.0
    hold_s = 1.0 / rate_hz_of(options)
    print(f"the frequency response is taken for one from samples held for {1e6 * hold_s:.6g} us")
    return hold_s


def rate_hz_of(options: argparse.Namespace) -> float:
    """Return the rate of the samples, the default one if none is given.

    Raises
    ------
    ValueError
        If it is not positive.
    """
    rate_hz = options.response_rate_hz
    rate_hz = USUAL_RATE_HZ if rate_hz is None else float(rate_hz)
    if not 0.0 < rate_hz < math.inf:
        raise ValueError(f"--response-rate-hz is {rate_hz:g}: give a positive rate")
    return rate_hz


def useless_response_options(options: argparse.Namespace) -> dict[str, bool]:
    """Return for each option whether it was given; they apply only to frequency responses."""
    return {"--response": options.response is not None,
            "--response-rate-hz": options.response_rate_hz is not None}
