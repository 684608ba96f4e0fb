# SPDX-License-Identifier: BSD-3-Clause
"""How often the 90 % intervals of the parameters of effects contain what they really are.

The plant's effects have a mathematical form of their own. These parameters mean the same in both.
"""

import numpy as np
from scipy.stats import norm

LEVEL = 0.9
"""Of the intervals."""

KNOWN = {
    "delay": {"delay_s": lambda effect: effect.delay_s},
    "backlash": {"width_um": lambda effect: 2.0 * effect.half_gap_um},
    "vibration_mode": {"frequency_rad_per_s": lambda effect: effect.frequency_rad_per_s,
                       "damping_ratio": lambda effect: effect.damping_ratio},
    "periodic_disturbance": {"frequency_hz": lambda effect: effect.frequency_hz},
}
"""What the parameters of a hidden effect should be found to be, by cause and name."""


def estimates(cause, effect, entries):
    """Return the parameters of a hidden effect beside those that were found.

    Parameters
    ----------
    cause : str
    effect : object
        Of the plant.
    entries : list of dict
        Effects of a verdict.

    Returns
    -------
    list of dict
        `name`, `true`, `found` and `standard_deviation` of each that means the same in both; empty
        where the effect was not named.
    """
    entry = next((entry for entry in entries if entry["name"] == cause), None)
    if entry is None or "standard_deviations" not in entry:
        return []
    return [{"cause": cause, "name": name, "true": float(of_plant(effect)),
             "found": entry["parameters"][name],
             "standard_deviation": entry["standard_deviations"][name]}
            for name, of_plant in KNOWN.get(cause, {}).items()]


def coverage(results):
    """Return how many intervals of the parameters contain them.

    Parameters
    ----------
    results : list of dict
        As `run_case` returns them.

    Returns
    -------
    dict
        `level` of the intervals, `intervals`, and how many are `right`.
    """
    found = [estimate for result in results for estimate in result.get("estimates", [])]
    half_width = norm.ppf(0.5 + 0.5 * LEVEL)
    right = [abs(each["found"] - each["true"]) <= half_width * each["standard_deviation"]
             for each in found]
    return {"level": LEVEL, "intervals": len(found), "right": int(np.count_nonzero(right))}
