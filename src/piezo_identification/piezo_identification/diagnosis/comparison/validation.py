# SPDX-License-Identifier: BSD-3-Clause
"""Errors before and after on the same held-out samples, and effects refused by them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.conditioning.waveforms import played
from piezo_identification.diagnosis.comparison.criteria import Reason, Undecided
from piezo_identification.fitting.effect_fit import fit_effects, impossible_effects
from piezo_identification.fitting.model_weights import HeldOut, Remainder, held_out_rows
from piezo_identification.fitting.regression import Fit, Regression
from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.recording import Recording


class Validation:
    """Samples that were not fitted, of another recording or of stretches of those diagnosed.

    The held-out recording has the sign of the model, and marked outliers. `reference` is the
    validation with the model as given, if the regression uses another model.
    """

    def __init__(self, regression: Regression, holdout: Recording | None = None,
                 reference: "Validation | None" = None) -> None:
        self.regression, self.holdout, self.reference = regression, holdout, reference

    def for_regression(self, regression: Regression) -> "Validation":
        """Return the validation for fits with another model, compared with the model as given."""
        return Validation(regression, self.holdout, self)

    @property
    def source(self) -> str:
        """Source of the samples."""
        if self.holdout is None:
            return "stretches of the recordings that were not fitted"
        return str(self.holdout.path)

    def errors(
        self, fit: Fit | None,
    ) -> tuple[dict[str, float], dict[str, float], dict[str, object]]:
        """Return errors of the model as given and of a fit, or of it alone, on the same samples.

        They are `rms_um` and `e_y_percent`. Also return the `source` and number of `samples`.
        """
        given, extended = self._given, self._of(fit)
        good = given.good & extended.good
        return (given.errors(good), extended.errors(good),
                {"source": self.source, "samples": int(np.count_nonzero(good))})

    def accepted(self, fit: Fit) -> tuple[Fit, dict[str, Undecided]]:
        """Remove the effects that are impossible or increase the error; return why, by name."""
        fit, refused = self._possible(fit)
        # On stretches of the same recordings, this was the criterion for selecting each effect.
        while self.holdout is not None and len(fit.effects) > 1:
            others = [self._without(fit, number) for number in range(len(fit.effects))]
            errors_um = [self._rms_um(other, fit) for other in others]
            number = min(range(len(others)), key=lambda number: errors_um[number][0])
            without_um, with_um = errors_um[number]
            if without_um > with_um:
                break
            refused[fit.effects[number].name] = self._worse(without_um, with_um)
            fit = others[number]
        if fit.effects and not self.improves(fit):
            without_um, with_um = self._rms_um(None, fit)
            refused |= {effect.name: self._worse(without_um, with_um) for effect in fit.effects}
            fit = self.regression.fit(())
        return fit, refused

    def improves(self, fit: Fit) -> bool:
        """Return whether the error of a fit is smaller than that of the model as given."""
        given_um, fit_um = self._rms_um(None, fit)
        return fit_um < given_um

    def rms_um(self, fit: Fit) -> float:
        """Return the RMS error of the model extended by a fit."""
        return self._rms_um(fit)[0]

    def remainders(self, fit: Fit) -> list[Remainder]:
        """Return the residual of a fit for each diagnosed recording and for the held-out one.

        For a fit without effects, that of the given model is used for the latter if it is smaller.
        """
        dataset, found = self.regression.dataset, []
        for recording, part, held_out in zip(
                dataset.recordings, dataset.simulated, held_out_rows(self.regression, fit),
                strict=True):
            measured_um = part.measured_um[part.begin :]
            found.append(Remainder(
                str(recording.path), held_out, part.sample_period_s, float(np.ptp(measured_um)),
                float(np.std(measured_um))))
        if self.holdout is not None:
            samples = [self._of(fit), *([] if fit.effects else [self._given])]
            best = min(samples, key=lambda each: each.errors(each.good)["rms_um"])
            measured_um, residual_um = best.measured_um[best.good], best.residual_um[best.good]
            found.append(Remainder(
                self.source, HeldOut(residual_um, np.zeros(residual_um.size, dtype=np.intp)),
                played(self.holdout).sample_period_s, float(np.ptp(measured_um)),
                float(np.std(measured_um))))
        return found

    def left_out(self) -> list[str]:
        """Return sentences on the samples of the held-out recording excluded as outliers."""
        if self.holdout is None:
            return []
        text = outlier_text(self.source, self._given.outlier, self._given.time_s)
        return [text] if text else []

    def _possible(self, fit: Fit) -> tuple[Fit, dict[str, Undecided]]:
        """Remove the effects that are physically impossible, and return why."""
        refused: dict[str, Undecided] = {}
        while impossible := impossible_effects(fit, self.regression.dataset.extent):
            number = next(number for number, effect in enumerate(fit.effects)
                          if effect.name in impossible)
            name = fit.effects[number].name
            refused[name] = Undecided(Reason.IMPOSSIBLE, impossible[name])
            fit = self._without(fit, number)
        return fit, refused

    def _worse(self, without_um: float, with_um: float) -> Undecided:
        return Undecided(
            Reason.WORSE_ON_HELD_OUT,
            f"with it the error on {self.source} rises from {1e3 * without_um:.3g} to "
            f"{1e3 * with_um:.3g} nm RMS")

    def _without(self, fit: Fit, number: int) -> Fit:
        """Remove one of the effects, and refit the others."""
        others = fit.without(number)
        return fit_effects(self.regression, others) if others else self.regression.fit(())

    def _rms_um(self, *fits: Fit | None) -> tuple[float, ...]:
        """Return the RMS errors of some fits on the samples that are good for all of them."""
        samples = [self._of(fit) for fit in fits]
        good = np.all([each.good for each in samples], axis=0)
        return tuple(each.errors(good)["rms_um"] for each in samples)

    @cached_property
    def _given(self) -> "_Samples":
        """Samples of the model as given."""
        if self.reference is not None:
            return self.reference._given
        regression = self.regression
        if self.holdout is not None:
            return _predicted(regression.dataset.model, self.holdout)
        return self._at_rows(regression.as_given().residual)

    def _of(self, fit: Fit | None) -> "_Samples":
        """Return samples of the model with a fit; those of the model as given if it is None."""
        if fit is None:
            return self._given
        if self.holdout is not None:
            return _predicted(self.regression.extended_model(fit), self.holdout)
        return self._at_rows(fit.residual)

    def _at_rows(self, residual: FloatArray) -> "_Samples":
        """Return samples for a residual, in tolerances, at the rows of the data set."""
        dataset = self.regression.dataset
        measured_um = dataset.at_rows([part.measured_um for part in dataset.simulated])
        time_s = dataset.at_rows([part.time_s for part in dataset.simulated])
        return _Samples(time_s, measured_um, residual * self.regression.tolerance_um,
                        self.regression.validation, np.zeros(time_s.size, dtype=bool))


@dataclass(frozen=True, eq=False)
class _Samples:
    """Measured displacement, residual, which samples count, and which are outliers.

    Samples before the model has settled do not count, but are no outliers.
    """

    time_s: FloatArray
    measured_um: FloatArray
    residual_um: FloatArray
    good: BoolArray
    outlier: BoolArray

    def errors(self, good: BoolArray) -> dict[str, float]:
        """Return the errors of some samples."""
        measured_um, residual_um = self.measured_um[good], self.residual_um[good]
        return {"rms_um": float(np.sqrt(np.mean(residual_um**2))),
                "e_y_percent": float(e_y_percent(measured_um, measured_um - residual_um))}


def _predicted(model: StageModel, recording: Recording) -> _Samples:
    """Predict all samples of a recording."""
    prediction = predict(model, recording)
    measured_um = np.zeros(recording.time_s.size)
    residual_um = measured_um.copy()
    good, outlier = np.zeros((2, measured_um.size), dtype=bool)
    # Samples count from where the model has settled.
    at = np.searchsorted(recording.sample_index, prediction.sample_index)
    measured_um[at] = prediction.measured_um
    residual_um[at] = prediction.measured_um - prediction.simulated_um
    good[at], outlier[at] = prediction.good, ~prediction.good
    return _Samples(recording.time_s, measured_um, residual_um, good, outlier)
