# SPDX-License-Identifier: BSD-3-Clause
"""Entries of the verdict for the effects found: parameters, uncertainty, error reduction."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.comparison.measures_of_fits import (
    contribution_rms,
    mean_square,
    noise,
)
from piezo_identification.diagnosis.evidence.stand_ins import as_stand_in
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect


def effect_entries(regression: Regression, fit: Fit) -> list[dict[str, Any]]:
    """Return the entry of each effect of a fit, in their order.

    Returns
    -------
    list of dict
        `name`, `parameters`, `error_reduction_percent` and, if known, `standard_deviations` of the
        fitted parameters. An effect that contributes less than the noise is a stand-in if another
        contributes more.
    """
    # Removing an effect, with all else unchanged, would increase the error by its contribution.
    added = [contribution_rms(regression, regression.fit(fit.without(number)), fit)
             for number in range(len(fit.effects))]
    residual = np.sqrt(mean_square(regression, fit))
    entries: list[dict[str, Any]] = [{
        "name": effect.name, "parameters": effect.parameters(),
        "error_reduction_percent": float(100.0 * (1.0 - residual / np.hypot(residual, each)))}
        for effect, each in zip(fit.effects, added, strict=True)]
    if fit.covariance is not None:
        _add_deviations(entries, fit.effects, fit.covariance)
    named = min(noise(regression), max(added, default=0.0))
    return [entry if each >= named else as_stand_in(entry)
            for entry, each in zip(entries, added, strict=True)]


def _add_deviations(entries: list[dict[str, Any]], effects: Sequence[Effect],
                    covariance: FloatArray) -> None:
    """Add the standard deviations of the fitted parameters."""
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    start = 0
    for entry, effect in zip(entries, effects, strict=True):
        entry["standard_deviations"] = named = {}
        for field in fields(effect):
            value, scale = getattr(effect, field.name), field.metadata["scale"]
            if scale == "fixed":
                continue
            size = len(value) if isinstance(value, tuple) else 1
            spread = deviations[start : start + size]
            start += size
            if scale == "logarithm":
                spread = spread * np.atleast_1d(value)
            named[field.name] = (
                [float(number) for number in spread] if isinstance(value, tuple)
                else float(spread[0])
            )
