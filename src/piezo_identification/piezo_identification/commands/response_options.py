# SPDX-License-Identifier: BSD-3-Clause
"""Options for the rows of a logger, and for frequency responses that may include a hold."""

import argparse
import math

E_Y = ("e_y: norm of the difference over that of the measured displacement without its mean "
       "(4.20), percent")

READINGS = {"start": 0.0, "end": 1.0}
"""Reading times, in sample periods after the change of the voltage of a row."""

HELD = "zero-order-hold"

USUAL_RATE_HZ = 40000.0


def add_rows_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--rows-read``."""
    parser.add_argument(
        "--rows-read", choices=tuple(READINGS), default="start",
        help="when the displacement of a row is read: as its voltage changes (default), or at the "
        "end of the hold, just before the next voltage")


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

    Raise ValueError if the rate does not apply to the response, or is not positive.
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

    Raise ValueError if it is not positive.
    """
    rate_hz = options.response_rate_hz
    rate_hz = USUAL_RATE_HZ if rate_hz is None else float(rate_hz)
    if not 0.0 < rate_hz < math.inf:
        raise ValueError(f"--response-rate-hz is {rate_hz:g}: give a positive rate")
    return rate_hz


def refuse_response_options(options: argparse.Namespace) -> None:
    """Raise ValueError for options that apply only to frequency responses."""
    for name in ("response", "response_rate_hz"):
        if getattr(options, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} has nothing to act on: leave it out, or "
                             "give a frequency response")
