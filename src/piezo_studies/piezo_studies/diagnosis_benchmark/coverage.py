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
"""What the parameters of a hidden effect are, by cause and name."""

OF_ANOTHER_FORM = ("backlash", "periodic_disturbance")
"""Hidden effects to which the named one can but come near: a play that sets in softly, and a hum
whose phase wanders."""


def estimates(cause, effect, entries, nearest=None):
    """Return the parameters of a hidden effect beside those that were found.

    Parameters
    ----------
    effect : object
        Of the plant.
    entries : list of dict
        Effects of a verdict.
    nearest : dict of str to float, optional
        Parameters of the named effect that come nearest to the hidden one, where the two have
        another form; see `nearest_effect`.

    Returns
    -------
    list of dict
        `name`, `drawn`, `true`, `found` and `standard_deviation` of each that means the same in
        both; empty where the effect was not named. What is true is what is nearest, where that is
        given, and what was drawn otherwise.
    """
    entry = next((entry for entry in entries if entry["name"] == cause), None)
    if entry is None or "standard_deviations" not in entry:
        return []
    told = []
    for name, of_plant in KNOWN.get(cause, {}).items():
        drawn = float(of_plant(effect))
        told.append({
            "cause": cause, "name": name, "drawn": drawn,
            "true": drawn if nearest is None else float(nearest[name]),
            "found": entry["parameters"][name],
            "standard_deviation": entry["standard_deviations"][name]})
    return told


def coverage(results, value="true"):
    """Return how many intervals of the parameters contain them.

    Parameters
    ----------
    results : list of dict
        As `run_case` returns them.
    value : str
        What they should contain: what is `true`, or what was `drawn`.

    Returns
    -------
    dict
        `level` of the intervals, `intervals`, and how many are `right`.
    """
    found = [estimate for result in results for estimate in result.get("estimates", [])]
    half_width = norm.ppf(0.5 + 0.5 * LEVEL)
    right = [abs(each["found"] - each[value]) <= half_width * each["standard_deviation"]
             for each in found]
    return {"level": LEVEL, "intervals": len(found), "right": int(np.count_nonzero(right))}
