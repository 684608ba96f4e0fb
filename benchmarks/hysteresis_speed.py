# SPDX-License-Identifier: BSD-3-Clause
"""Compare the Preisach model with relays and with an Everett look-up, in samples per second."""

import timeit

import numpy as np
from everett_look_up import invert_look_up, look_up, table_of
from numba import njit
from stage_model import VOLTAGE_RANGE_V, preisach_model

from piezo_studies.baselines.relay_grid import cell_centre_relays, simulate_relays

SAMPLES = 200_000
# The relay grids take longer per sample, so they get fewer.
RELAY_SAMPLES = 300
BISECTIONS = 20
REPEATS = 5


def voltages(count):
    """Reversals at random voltages, 50 samples from one to the next, shape (count,)."""
    turns_v = np.random.default_rng(1).uniform(*VOLTAGE_RANGE_V, count // 50 + 2)
    return np.interp(np.arange(count) / 50, np.arange(len(turns_v)), turns_v)


def samples_per_s(levels):
    """Return the speed of every method on a grid of so many levels, by its name."""
    model = preisach_model(levels)
    alpha_v, beta_v, weight_um = relays = cell_centre_relays(model)
    many_v, few_v = voltages(SAMPLES), voltages(RELAY_SAMPLES)
    many_um = model.simulate(many_v)
    few_um = simulate_relays(few_v, *relays)
    tabled = (table_of(model), model.voltage_min_v, model.cell_width_v, model.offset_um)
    return {
        "forward": _speed(model.simulate, many_v),
        "forward, Everett look-up": _speed(look_up, many_v, *tabled),
        "forward, compiled relays": _speed(simulate_relays, few_v, *relays),
        "forward, NumPy relays": _speed(numpy_relays, few_v, *relays),
        "inverse": _speed(model.invert, many_um),
        "inverse, Everett look-up": _speed(invert_look_up, look_up(many_v, *tabled), *tabled),
        "inverse, compiled relays": _speed(invert_relays, few_um, alpha_v, beta_v, weight_um),
    }


def look_up_error_percent(levels):
    """Largest difference of the look-up from the model, in percent of the model's span."""
    model, many_v = preisach_model(levels), voltages(SAMPLES)
    looked_up_um = look_up(many_v, table_of(model), model.voltage_min_v, model.cell_width_v,
                           model.offset_um)
    return 100.0 * np.abs(looked_up_um - model.simulate(many_v)).max() / np.ptp(
        model.output_range_um)


def numpy_relays(voltage_v, alpha_v, beta_v, weight_um):
    """Hysteresis output, every relay visited at every sample by NumPy."""
    on = np.zeros(len(alpha_v), dtype=bool)
    output_um = np.empty(len(voltage_v))
    for n, v in enumerate(voltage_v):
        on = (on | (v >= alpha_v)) & (v >= beta_v)
        output_um[n] = weight_um[on].sum()
    return output_um


@njit
def invert_relays(output_um, alpha_v, beta_v, weight_um):
    """Voltage of each output by bisection, every relay visited at every trial."""
    on = np.zeros(len(alpha_v), dtype=np.bool_)
    voltage_v = np.empty(len(output_um))
    for n in range(len(output_um)):
        low_v, high_v = beta_v.min(), alpha_v.max()
        for _ in range(BISECTIONS):
            middle_v = (low_v + high_v) / 2
            total_um = 0.0
            for r in range(len(on)):
                if middle_v >= alpha_v[r] or (on[r] and middle_v >= beta_v[r]):
                    total_um += weight_um[r]
            if total_um < output_um[n]:
                low_v = middle_v
            else:
                high_v = middle_v
        for r in range(len(on)):
            on[r] = high_v >= alpha_v[r] or (on[r] and high_v >= beta_v[r])
        voltage_v[n] = high_v
    return voltage_v


def _speed(function, sequence, *arguments):
    """Return samples per second, the fastest of a few repeats."""
    function(sequence[:10], *arguments)  # compiles
    times_s = timeit.repeat(lambda: function(sequence, *arguments), number=1, repeat=REPEATS)
    return len(sequence) / min(times_s)
