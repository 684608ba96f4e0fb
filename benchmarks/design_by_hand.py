# SPDX-License-Identifier: BSD-3-Clause
"""Dynamics and a feedback by hand, with SciPy and python-control alone; see docs/comparison.md.

    python benchmarks/design_by_hand.py DYNAMICS.csv

The table has the columns time_s, voltage_v and displacement_um of a short square wave, such as
`waveforms --experiments dynamics` writes. Hysteresis, creep and their inverse are left out.
"""

import sys

import control
import numpy as np
from scipy.optimize import least_squares

TICK_S = 1e-3
SECOND_TICK_SHARE = 0.5  # a mean over a tick, held for a tick: one and a half ticks of delay


def plant(parameters):
    """Return a gain, a lag and modes as a transfer function."""
    gain, lag_ms, *modes = parameters
    made = control.tf([gain], [1e-3 * lag_ms, 1.0])
    for at in range(0, len(modes), 2):
        omega, damping = 1e3 * modes[at], modes[at + 1]
        made = made * control.tf([omega**2], [1.0, 2.0 * damping * omega, omega**2])
    return made


def simulated(parameters, voltage_v, period_s):
    """Return the displacement (um) under held voltages."""
    sampled = control.c2d(control.ss(plant(parameters)), period_s, "zoh")
    return control.forced_response(sampled, inputs=voltage_v).outputs


def identify(time_s, voltage_v, displacement_um):
    """Fit the parameters from two starting points; return the better ones."""
    period_s = float(np.median(np.diff(time_s)))
    centred_v = voltage_v - voltage_v.mean()
    settled = slice(len(time_s) // 2, None)

    def error(parameters):
        difference = simulated(parameters, centred_v, period_s) - displacement_um
        return difference[settled] - difference[settled].mean()

    fits = [least_squares(error, [1.0, 0.5, first, 0.5, second, 0.1], x_scale=np.full(6, 0.1),
                          bounds=([0.0, 0.01, 0.5, 0.01, 0.5, 0.01],
                                  [10.0, 10.0, 20.0, 2.0, 20.0, 2.0]))
            for first, second in ((2.0, 4.0), (3.0, 6.0))]
    return min(fits, key=lambda fit: fit.cost).x


def design(model):
    """Return the delayed plant, an H-infinity feedback and its gamma."""
    delay = control.tf(*control.pade((1.0 + SECOND_TICK_SHARE) * TICK_S, 2))
    seen = control.ss(model * delay)
    error_weight = control.tf([0.5, 2 * np.pi * 60.0], [1.0, 2 * np.pi * 0.06])
    effort_weight = control.tf([0.05], [1.0])
    output_weight = control.tf([1.0, 2 * np.pi * 20.0], [0.01, 2 * np.pi * 400.0])
    law, _, (gamma, *_) = control.mixsyn(seen, error_weight, effort_weight, output_weight)
    return seen, law, gamma


def main():
    """Identify from the file that is named, design, and print both."""
    time_s, voltage_v, displacement_um = np.loadtxt(
        sys.argv[1], delimiter=",", skiprows=1, unpack=True)
    found = identify(time_s, voltage_v, displacement_um)
    print("gain, lag (ms), modes (krad/s) and dampings:", np.round(found, 4))
    seen, law, gamma = design(plant(found))
    loop = seen * law
    gain_margin, phase_margin_deg, *_ = control.margin(loop)
    worst = max(abs(control.feedback(1, loop)(2j * np.pi * f))
                for f in np.geomspace(0.1, 500, 400))
    print(f"gamma {gamma:.3f}, gain margin {gain_margin:.2f}, phase margin "
          f"{phase_margin_deg:.1f} deg, worst sensitivity {worst:.2f}, order {law.nstates}")


if __name__ == "__main__":
    main()
