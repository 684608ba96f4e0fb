# SPDX-License-Identifier: BSD-3-Clause
"""Algorithm 1 of section 3.3.2 compared with the exact inverse of the same hysteresis.

As printed, the next voltage is chosen for the present sample, and the search ends only within the
tolerance, which a step may skip. Here, the voltage is chosen for its own sample, and the search
also ends if the sign of the error changes.
"""

import time

import numpy as np

from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.learned_tracking import wrong_model

SECTION = "3.3.2, Algorithm 1"
HIGHEST_V, LEVELS = 60.0, 180
STEP_V = HIGHEST_V / LEVELS
"""Step by (3.15) with a coefficient of 1 and the other values of section 3.4."""

MOST_STEPS = LEVELS
SAMPLES_PER_PERIOD, PERIODS = 1000, 3
CENTRE_UM, AMPLITUDE_UM = 30.0, 40.0


def study():
    """Compute errors and computing times of both inverses."""
    hysteresis = wrong_model(0.0, 0).hysteresis
    angle = 2.0 * np.pi * np.arange(SAMPLES_PER_PERIOD * PERIODS) / SAMPLES_PER_PERIOD
    wanted_um = CENTRE_UM + AMPLITUDE_UM / 2 * np.sin(angle)
    rows = []
    for name, invert in (("by steps", invert_by_steps), ("exact", type(hysteresis).invert)):
        invert(hysteresis, wanted_um[:2])  # compiles
        begin_s = time.perf_counter()
        voltage_v = invert(hysteresis, wanted_um)
        taken_s = time.perf_counter() - begin_s
        error_um = hysteresis.simulate(voltage_v) - wanted_um
        rows.append(Row(
            SECTION, f"e_rms of the hysteresis' inverse, {name}", None,
            100.0 * np.std(error_um[SAMPLES_PER_PERIOD:]) / AMPLITUDE_UM, "%",
            f"{1e6 * taken_s / wanted_um.size:.2g} us a sample"))
    return Study(rows)


def invert_by_steps(hysteresis, wanted_um, step_v=STEP_V, tolerance_um=0.0):
    """Invert the hysteresis by steps from the voltage of the previous sample.

    Parameters
    ----------
    wanted_um : (N,) array
        Wanted output of the hysteresis.
    step_v : float
        Step delta_h of (3.15).
    tolerance_um : float
        Tolerance e_r at which the search ends.

    Returns
    -------
    (N,) array
        Voltages in V.
    """
    memory = hysteresis.memory()
    voltage_v = np.empty(len(wanted_um))
    for k, wanted in enumerate(wanted_um):
        direction = np.sign(wanted - memory.hysteresis_um)
        for _ in range(MOST_STEPS):
            missing_um = direction * (wanted - memory.hysteresis_um)
            if missing_um <= tolerance_um:
                break
            hysteresis.simulate([memory.voltage_v + direction * step_v], memory)
        voltage_v[k] = memory.voltage_v
    return voltage_v
