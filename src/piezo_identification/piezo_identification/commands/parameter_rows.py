# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of a model as rows for people: with standard deviations, and Hz beside rad/s."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from piezo_models.identified_model import IdentifiedModel

DIGITS = 5
"""Significant, where no standard deviation says how many are known."""


def parameter_rows(identified: IdentifiedModel) -> list[tuple[str, str]]:
    """Return name and value of each linear parameter, in the order of the signal path.

    Returns
    -------
    list of (str, str)
    """
    creep, dynamics = identified.model.creep, identified.model.dynamics
    of_creep = identified.uncertainties.get("creep", {})
    of_dynamics = identified.uncertainties.get("dynamics", {})
    time_constant_ms = 1e3 * dynamics.time_constant_s
    lag_deviation = [1e3 * value for value in _deviations(of_dynamics, "time_constant_s")]
    frequencies = "mode_frequencies_rad_per_s"
    return [
        ("creep poles", _listing(
            creep.poles_rad_per_s, _deviations(of_creep, "poles_rad_per_s"), "rad/s")),
        ("creep zeros", _listing(
            creep.zeros_rad_per_s, _deviations(of_creep, "zeros_rad_per_s"), "rad/s")),
        ("electric time constant", _listing([time_constant_ms], lag_deviation, "ms")),
        ("mode frequencies", _listing(
            dynamics.mode_frequencies_rad_per_s, _deviations(of_dynamics, frequencies), "rad/s")),
        *([("", _listing(
            [value / (2.0 * np.pi) for value in dynamics.mode_frequencies_rad_per_s],
            [value / (2.0 * np.pi) for value in _deviations(of_dynamics, frequencies)], "Hz"))]
          if dynamics.mode_frequencies_rad_per_s else []),
        ("damping ratios", _listing(
            dynamics.damping_ratios, _deviations(of_dynamics, "damping_ratios"), "")),
    ]


def _deviations(uncertainties: Mapping[str, Any], name: str) -> list[float]:
    values = uncertainties.get(name)
    return [] if values is None else np.atleast_1d(np.asarray(values, float)).tolist()


def _listing(values: Sequence[float], deviations: Sequence[float], unit: str) -> str:
    texts = [with_deviation(value, deviation) for value, deviation in zip_longest(
        list(values), list(deviations)[:len(values)])]
    return f"{', '.join(texts)} {unit}".rstrip() if texts else "none"


def with_deviation(value: float, deviation: float | None) -> str:
    """Return a value with its standard deviation, both to two digits of the deviation.

    Parameters
    ----------
    deviation : float or None
        None, 0 or not finite where it is not known.
    """
    if deviation is None or not np.isfinite(deviation) or deviation <= 0.0:
        return f"{value:.{DIGITS}g}"
    decimals = 1 - int(np.floor(np.log10(deviation)))
    if 0 <= decimals <= DIGITS + 2:
        return f"{value:.{decimals}f} +- {deviation:.{decimals}f}"
    return f"{value:.{DIGITS}g} +- {deviation:.2g}"
