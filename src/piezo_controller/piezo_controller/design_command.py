# SPDX-License-Identifier: BSD-3-Clause
"""`design`: from a model file to a controller file, with a report and pictures."""

import argparse
import sys
from hashlib import sha256
from pathlib import Path

from piezo_controller.controller_file import save_controller
from piezo_controller.feedback_design import design_feedback, design_plant
from piezo_controller.loop_pictures import draw_bode, draw_nyquist
from piezo_controller.weights import load_weights
from piezo_models.model_file import load_model

CLOCK_PERIOD_S = 25e-6
ROWS = (
    ("gamma", "H-infinity norm reached", "{:.3f}"),
    ("order", "order of the controller", "{:d}"),
    ("hysteresis_gain_um_per_v", "nominal hysteresis gain k_h", "{:.3f} um/V"),
    ("bandwidth_hz", "bandwidth (S at -3 dB)", "{:.1f} Hz"),
    ("peak_sensitivity", "peak sensitivity Ms", "{:.2f}"),
    ("peak_frequency_hz", "  at", "{:.0f} Hz"),
    ("gain_margin", "gain margin", "{:.2f}"),
    ("phase_margin_deg", "phase margin", "{:.0f} deg"),
    ("settling_to_5_percent_s", "settling to 5 %", "{:.3f} s"),
    ("stable_within_gain_spread", "stable for all hysteresis gains", "{}"),
)


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
    parser = argparse.ArgumentParser(prog="design", description=__doc__.split(": ", 1)[1])
    parser.add_argument("--model", type=Path, required=True, help="model file")
    parser.add_argument("--weights", type=Path,
                        help="weights file (YAML); the thesis' weights by default")
    parser.add_argument("--output", type=Path, required=True,
                        help="controller file to write; the pictures are put beside it")
    options = parser.parse_args(arguments)
    try:
        _design(options.model, options.weights, options.output)
    except (ValueError, OSError) as error:
        print(f"design: {error}", file=sys.stderr)
        return 2
    return 0


def _design(model_path, weights_path, output):
    model = load_model(model_path).model
    weights = load_weights(weights_path)
    digest = sha256(model_path.read_bytes()).hexdigest()
    controller = design_feedback(model, weights, CLOCK_PERIOD_S, digest)
    save_controller(output, controller)
    plant, gain_um_per_v = design_plant(model, weights.sample_period_s, CLOCK_PERIOD_S)
    bode, nyquist = (output.with_name(f"{output.stem}_{name}.png") for name in ("bode", "nyquist"))
    draw_bode(bode, gain_um_per_v * plant, controller.state_space(), weights)
    draw_nyquist(nyquist, gain_um_per_v * plant, controller.state_space(),
                 weights.hysteresis_uncertainty)
    for key, label, layout in ROWS:
        value = controller.report[key]
        text = ("yes" if value else "no") if isinstance(value, bool) else layout.format(value)
        print(f"{label:34s}{text}")
    print(f"written: {output}, {bode}, {nyquist}")


if __name__ == "__main__":
    sys.exit(main())
