# SPDX-License-Identifier: BSD-3-Clause
"""How often the 90 % intervals of the parameters of effects contain the true values.

The effects of the plant have a different mathematical form from those of the model. Only parameters
with the same meaning in both are evaluated.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm

from piezo_models.effects import fitted_values, with_fitted_values


def nearest_parameters(effect, without_um, added_um, sample_period_s, regression):
    """Return the parameters with which an effect of the named form approximates a hidden one best.

    The response of the plant without the hidden effect, and the contribution of that effect, (N,)
    each, are free of noise, so the parameters contain neither model errors nor errors from fitting
    noise. The regression on one recording of these samples gives rows, weights and regressors.
    """
    rows, = regression.dataset.rows
    values, low, high = fitted_values(effect, regression.dataset.extent)

    def error(numbers):
        tried = with_fitted_values(effect, numbers)
        missing_um = added_um + without_um - tried.apply(without_um, sample_period_s)
        return regression.remainder(missing_um[rows] / regression.tolerance_um)

    solution = least_squares(error, np.clip(values, low, high), bounds=(low, high), x_scale="jac")
    return with_fitted_values(effect, solution.x).parameters()


LEVEL = 0.9
"""Confidence level of the intervals."""

KNOWN = {
    "delay": {"delay_s": lambda effect: effect.delay_s},
    "backlash": {"width_um": lambda effect: 2.0 * effect.half_gap_um},
    "vibration_mode": {"frequency_rad_per_s": lambda effect: effect.frequency_rad_per_s,
                       "damping_ratio": lambda effect: effect.damping_ratio},
    "periodic_disturbance": {"frequency_hz": lambda effect: effect.frequency_hz},
}
"""Functions that return the parameters of a hidden effect, by cause and name."""

OF_ANOTHER_FORM = ("backlash", "periodic_disturbance")
"""Hidden effects that the named one can only approximate: a play with a gradual onset, and hum
with a wandering phase."""


def estimates(cause, effect, entries, nearest=None):
    """Return the parameters of a hidden effect together with their estimates.

    Each comparable parameter has an entry with `name`, `drawn`, `true`, `found` and
    `standard_deviation`; there is none if the effect was not named. The true value is that of
    `nearest_parameters` if these are given, and the drawn one otherwise.
    """
    entry = next((entry for entry in entries if entry["name"] == cause), None)
    if entry is None or "standard_deviations" not in entry:
        return []
    found_intervals = []
    for name, of_plant in KNOWN.get(cause, {}).items():
        drawn = float(of_plant(effect))
        found_intervals.append({
            "cause": cause, "name": name, "drawn": drawn,
            "true": drawn if nearest is None else float(nearest[name]),
            "found": entry["parameters"][name],
            "standard_deviation": entry["standard_deviations"][name]})
    return found_intervals


def coverage(results, value="true"):
    """Return the confidence level, the number of intervals, and how many contain their parameter.

    The value that they should contain is the one named `value`: `true` or `drawn`.
    """
    found = [estimate for result in results for estimate in result.get("estimates", [])]
    half_width = norm.ppf(0.5 + 0.5 * LEVEL)
    right = [abs(each["found"] - each[value]) <= half_width * each["standard_deviation"]
             for each in found]
    return {"level": LEVEL, "intervals": len(found), "right": int(np.count_nonzero(right))}
