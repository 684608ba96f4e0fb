# SPDX-License-Identifier: BSD-3-Clause
"""Effects that fit but are not credible: what the model lacks behaves like them."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from piezo_models.effects import Effect, Extent, known_effects

AT_BOUND = 0.01
"""Relative distance from a bound within which a fitted parameter counts as at the bound."""

LEAST_PROBABILITY = 1e-3
"""Probability below which an effect is a guess, and the uncertainty of its parameters is
invalid."""

STAND_IN = "stand_in"


def with_stand_ins(entries: Sequence[dict[str, Any]], extent: Extent,
                   probabilities: Mapping[str, float]) -> list[dict[str, Any]]:
    """Mark the entries of effects that are not credible, and remove their standard deviations.

    Parameters
    ----------
    probabilities : dict of str to float
        Probabilities of sets of effects, with names joined by +; empty if unknown.
    """
    return [as_stand_in(entry) if _is_stand_in(entry, extent, probabilities) else entry
            for entry in entries]


def as_stand_in(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Mark the entry of an effect, without its standard deviations."""
    return {name: value for name, value in entry.items()
            if name != "standard_deviations"} | {STAND_IN: True}


def _is_stand_in(entry: Mapping[str, Any], extent: Extent,
                 probabilities: Mapping[str, float]) -> bool:
    kind = known_effects().get(entry["name"])
    if kind is None:
        return False
    share = sum(value for name, value in probabilities.items()
                if entry["name"] in name.split("+"))
    return bool(probabilities) and share < LEAST_PROBABILITY or _is_at_a_bound(
        kind, entry["parameters"], extent)


def _is_at_a_bound(kind: type[Effect], parameters: Mapping[str, Any], extent: Extent) -> bool:
    """Return whether a parameter ended at a bound set by the recordings rather than by physics."""
    declared = {field.name: field.metadata for field in fields(kind)}
    for name, bounds in kind.bounds(extent).items():
        nature = declared[name]
        if nature["scale"] == "fixed":
            continue
        ends = np.array([end for end, natural in zip(
            bounds, (nature["low"], nature["high"]), strict=True) if end != natural])
        values = np.atleast_1d(parameters[name])
        if np.any(np.abs(values[:, None] - ends) <= AT_BOUND * np.abs(ends)):
            return True
    return False


def name_of(entry: Mapping[str, Any]) -> str:
    """Return the name of an effect for use in a sentence."""
    return f"what behaves like {entry['name']}" if entry.get(STAND_IN) else str(entry["name"])
