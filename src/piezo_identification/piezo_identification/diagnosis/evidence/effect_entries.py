# SPDX-License-Identifier: BSD-3-Clause
"""Effects that fit but are not credible: what the model lacks behaves like them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.diagnosis.comparison.criteria import (
    CRITERIA,
    contribution_rms,
    mean_square,
    noise,
)
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, Extent, known_effects
from piezo_models.effects.converter_steps import SensorSteps
from piezo_models.effects.outliers import FEWEST, THRESHOLD, Outliers

AT_BOUND = 0.01
"""Relative distance from a bound within which a fitted parameter counts as at the bound."""

LEAST_PROBABILITY = 1e-3
"""Probability below which an effect is a guess, and the uncertainty of its parameters is
invalid."""

STAND_IN = "stand_in"

NEXT_STEP = 1.6
"""Largest error of a reading that is rounded to the neighbouring step, in steps of the sensor."""


def effect_entries(regression: Regression, fit: Fit) -> list[dict[str, Any]]:
    """Return the entry of each effect of a fit, in their order.

    It has `name`, `parameters`, `error_reduction_percent` and, if known, `standard_deviations` of
    the fitted parameters. An effect that contributes less than the noise is a stand-in if another
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
        add_deviations(entries, fit.effects, fit.covariance)
    named = min(noise(regression), max(added, default=0.0))
    return [entry if each >= named else as_stand_in(entry)
            for entry, each in zip(entries, added, strict=True)]


def add_deviations(entries: list[dict[str, Any]], effects: Sequence[Effect],
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


def with_stand_ins(entries: Sequence[dict[str, Any]], extent: Extent,
                   probabilities: Mapping[str, float]) -> list[dict[str, Any]]:
    """Mark the entries of effects that are not credible, and remove their standard deviations.

    The probabilities are those of sets of effects, with names joined by +; empty if unknown.
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


@dataclass(frozen=True)
class FoundOutliers:
    """Number and size of the outliers of all recordings."""

    count: int

    share: float
    """Fraction of the samples."""
    size_um: float
    """RMS error of these samples."""

    def effect(self, regression: Regression) -> Outliers:
        """Return the effect that represents them in the extended model."""
        threshold_um = THRESHOLD * float(np.median(regression.noise.noise_um))
        return Outliers(self.share, self.size_um, threshold_um)

    def entry(self, regression: Regression, fit: Fit) -> dict[str, Any]:
        """Return their entry of the verdict, in addition to the effects of a fit."""
        residual_rms_um = regression.residual_um(fit)
        with_them = np.hypot(residual_rms_um, np.sqrt(self.share) * self.size_um)
        return {
            "name": Outliers.name,
            "parameters": {"share": self.share, "size_um": self.size_um},
            "error_reduction_percent": float(100.0 * (1.0 - residual_rms_um / with_them)),
        }


def found_outliers(regression: Regression,
                   effects: Sequence[Effect] = ()) -> FoundOutliers | None:
    """Return the outliers if they are more than expected by chance and large enough to be named.

    If a named effect is that the sensor has steps, a reading of a neighbouring step is no outlier.
    """
    least_um = max((NEXT_STEP * effect.step_um for effect in effects
                    if isinstance(effect, SensorSteps)), default=0.0)
    off_um, samples = [], 0
    for index, part in enumerate(regression.dataset.simulated):
        settled = slice(part.begin, None)
        outlier = regression.noise.outliers[index][settled]
        # Samples that stand out of the residual only have no interpolated neighbours.
        unexplained_um = residual_um(regression.dataset, index, noise=regression.noise)
        off_model_um = np.where(part.outlier, part.off_um, unexplained_um)[settled]
        off_um.append(off_model_um[outlier & (np.abs(off_model_um) >= least_um)])
        samples += outlier.size
    joined_um = np.concatenate(off_um)
    if joined_um.size < FEWEST:
        return None
    size_um = float(np.sqrt(np.mean(joined_um**2)))
    share = joined_um.size / samples
    if np.sqrt(share) * size_um < CRITERIA.noticeable * np.median(regression.tolerance_um):
        return None
    return FoundOutliers(int(joined_um.size), float(share), size_um)


def left_out(regression: Regression) -> list[str]:
    """Return a sentence on the excluded samples of each recording that has any."""
    texts = [outlier_text(part.path, outlier, part.time_s) for part, outlier in
             zip(regression.dataset.simulated, regression.noise.outliers, strict=True)]
    return [text for text in texts if text]
