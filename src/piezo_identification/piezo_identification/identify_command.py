# SPDX-License-Identifier: BSD-3-Clause
"""`identify`: from recordings to a model file."""

import argparse
import sys
from pathlib import Path

from piezo_identification.identify import identify
from piezo_identification.sensor_sign import displacement_falls
from piezo_models.model_file import save_model
from piezo_recorder.reader import read_recording

EXPERIMENTS = {
    "creep": "long square wave",
    "dynamics": "short square wave at the full sample clock",
    "hysteresis": "harmonics of rising amplitude from the lowest voltage",
    "validation": "any other input: the errors are measured on it",
}


def main(arguments=None):
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        The command line's by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for input that cannot be used.
    """
    parser = argparse.ArgumentParser(
        prog="identify", description="Identify a stage model from recordings.",
        epilog="FILE is a recording (a rosbag2 directory or an .mcap), or a CSV with the header "
        "time_s,voltage_v,displacement_um whose rows are samples at their instants. Without "
        "--creep the model does not creep; without --dynamics it answers at once.",
    )
    for name, help_text in EXPERIMENTS.items():
        parser.add_argument(f"--{name}", metavar="FILE", type=Path, help=help_text,
                            required=name == "hysteresis")
    parser.add_argument("--output", metavar="MODEL", type=Path, required=True,
                        help="model file to write")
    parser.add_argument("--refine", action="store_true",
                        help="fit all components together at the end; keeps what is better on "
                        "data held out, and prints the errors before and after")
    for name, what in (("creep-pairs", "pole and zero pairs of the creep"),
                       ("modes", "vibration modes")):
        parser.add_argument(f"--{name}", metavar="NUMBER", type=int, choices=range(1, 11),
                            help=f"number of {what}; by default chosen from the data")
    options = parser.parse_args(arguments)
    try:
        _identify({name: getattr(options, name) for name in EXPERIMENTS}, options)
    except (ValueError, OSError) as error:
        print(f"identify: {error}", file=sys.stderr)
        return 2
    return 0


def _identify(paths, options):
    output = options.output
    # Before the work, not after it.
    if output.is_dir() or not output.absolute().parent.is_dir():
        raise ValueError(f"{output} is no file in an existing directory: choose another --output")
    recordings = {}
    for name, path in paths.items():
        if path is not None:
            print(f"reading {path}", flush=True)
            recordings[name] = read_recording(path)
    if displacement_falls(recordings["hysteresis"]):
        print("the displacement falls as the voltage rises: its sign is changed throughout")
    identified = identify(
        **recordings, progress=_print_progress, refine=options.refine, note=print,
        creep_pairs=options.creep_pairs, modes=options.modes)
    save_model(output, identified)
    _print_summary(identified)
    print(f"model written to {output}")


def _print_progress(stage, fraction):
    print(f"{100.0 * fraction:3.0f} %  {stage}", flush=True)


def _print_summary(identified):
    model = identified.model
    low_um, high_um = model.hysteresis.output_range_um
    rows = [
        ("voltage range", "{:g} to {:g} V".format(*identified.voltage_range_v)),
        ("hysteresis range", f"{high_um - low_um:.3f} um"),
        ("creep poles", _listing(model.creep.poles_rad_per_s, "rad/s")),
        ("creep zeros", _listing(model.creep.zeros_rad_per_s, "rad/s")),
        ("electric time constant", f"{1e3 * model.dynamics.time_constant_s:.5g} ms"),
        ("mode frequencies", _listing(model.dynamics.mode_frequencies_rad_per_s, "rad/s")),
        ("damping ratios", _listing(model.dynamics.damping_ratios, "")),
        *_error_rows(identified.errors),
    ]
    for name, value in rows:
        print(f"{name:24}{value}" if len(name) < 24 else f"{name}  {value}")


def _error_rows(errors, prefix=""):
    """Name and value of every error, those in groups under the name of their group."""
    for name, value in errors.items():
        if isinstance(value, dict):
            yield from _error_rows(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", f"{value:.3g}"


def _listing(values, unit):
    return f"{', '.join(f'{value:.5g}' for value in values) or 'none'} {unit}".rstrip()


if __name__ == "__main__":
    sys.exit(main())
