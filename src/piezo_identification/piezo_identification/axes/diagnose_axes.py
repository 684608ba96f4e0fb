# SPDX-License-Identifier: BSD-3-Clause
"""Find what a model of several axes lacks to explain a recording or a frequency response."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import softmax

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_common.text_file import replace_json
from piezo_identification.axes.axes_response import AxesResponse
from piezo_identification.axes.axis_effects import AxisEffect, ModeOfAxis
from piezo_identification.axes.diagnosed_errors import (
    DiagnosedErrors,
    ErrorsInRecording,
    ErrorsInResponse,
    by_effect,
    joined_values,
)
from piezo_identification.conditioning.row_alignment import SIGNIFICANT
from piezo_identification.diagnosis.comparison.criteria import CRITERIA, GUESS
from piezo_identification.diagnosis.evidence.effect_entries import AT_BOUND
from piezo_identification.diagnosis.joint.probabilities import (
    ALTERNATIVE,
    BELIEVED,
    LISTED,
    SOMETHING_ELSE,
)
from piezo_identification.diagnosis.response.response_diagnosis import NEAR_NOISE
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.evidence import independent_errors, log_evidence
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import save_axes_model
from piezo_recorder.reading.axes import AxesRecording


@dataclass(frozen=True, eq=False, repr=False)
class AxesDiagnosis:
    """What a model of several axes lacks to explain a recording or a frequency response."""

    verdict: str
    """One of "none", "explained" or "unexplained"."""
    effects: list[dict[str, Any]]
    """Entries as in `verdict.json`, the strongest first."""
    extended: IdentifiedAxes
    """Model with the effects."""
    before: dict[str, dict[str, float]]
    after: dict[str, dict[str, float]]
    """`rms_um` and `e_y_percent` of each axis."""
    noise_floor_um: dict[str, float]
    """Standard deviation of the noise of each sensor."""
    probabilities: dict[str, float]
    """Probability of each set of effects, of `none` and of `something_else`, in descending
    order."""
    confounded_with: dict[str, str]
    """Effects that the data cannot distinguish from a named one, and that effect."""
    not_shown: dict[str, str]
    """Effects that the data cannot show at all, and why."""
    left: str
    """Sentence on the residual if it is more than noise."""

    def document(self) -> dict[str, Any]:
        """Return the content of `verdict.json`."""
        because = self._not_decidable_because()
        return {"verdict": self.verdict, "effects": self.effects, "before": self.before,
                "after": self.after, "noise_floor_um": self.noise_floor_um,
                "not_decidable": list(because), "not_decidable_because": because,
                "not_told_from": self.confounded_with, "left": self.left,
                "probabilities": self.probabilities}

    def _not_decidable_because(self) -> dict[str, str]:
        return self.not_shown | {name: f"explains the data like {other}"
                                 for name, other in self.confounded_with.items()}

    def write(self, directory: Path) -> None:
        """Write `verdict.json` and `extended_model.json` into a folder, which is made."""
        directory.mkdir(parents=True, exist_ok=True)
        replace_json(directory / "verdict.json", self.document())
        save_axes_model(directory / "extended_model.json", self.extended)

    def summary(self) -> SummaryTable:
        """Return effects with deviations, and the errors of each axis, as a table."""
        rows: list[tuple[str | float | None, ...]] = []
        for entry in self.effects:
            for name, off in entry["standard_deviations"].items():
                rows.append((f"{_label(entry)} {name}", entry["parameters"][name], off))
        for axis, error in self.before.items():
            for name, value in error.items():
                rows += [(f"{axis} {name} before", value, None),
                         (f"{axis} {name} after", self.after[axis][name], None)]
            rows.append((f"{axis} noise_floor_um", self.noise_floor_um[axis], None))
        likely = ", ".join(f"{name} {share:.3f}" for name, share in self.probabilities.items())
        notes = [f"probability: {likely}"]
        notes += [f"not decidable: {name}, {because}"
                  for name, because in self._not_decidable_because().items()]
        return SummaryTable(f"verdict: {self.verdict}", ("", "value", "std. dev."), rows,
                            (*notes, *filter(None, [self.left])))

    def __repr__(self) -> str:
        return repr(self.summary())


def diagnose_axes(identified: IdentifiedAxes,
                  data: AxesRecording | AxesResponse) -> AxesDiagnosis:
    """Find the effect, or the two effects, that a model lacks to explain a recording or response.

    Errors in a response are those of the gain, in um/V. Raise ValueError if the data are of other
    axes, of a shorter sample period, too short, or without motion, if a displacement is constant,
    or if the model has more than a response can show.
    """
    errors: DiagnosedErrors = (
        ErrorsInResponse(identified, data) if isinstance(data, AxesResponse)
        else ErrorsInRecording(identified, data))
    seen = errors.effects()
    fits = {found: _fitted(errors, found) for found in [(), *((each,) for each in seen)]}
    best_first = sorted((each for each in seen if fits[each,].stands or not isinstance(
        each, ModeOfAxis)), key=lambda each: fits[each,].mean_square)
    fits |= {found: _fitted(errors, found) for found in combinations(best_first, 2)
             if best_first.index(found[0]) < CRITERIA.alternatives}
    least = min(fits, key=lambda found: fits[found].mean_square)
    known = np.mean(np.broadcast_to(errors.known_squares, errors.residual(
        (), np.zeros(0)).shape), axis=0)
    counts = np.array([
        independent_errors(column) for column in errors.residual(least, fits[least].values).T])

    def evidence(squares: FloatArray, numbers: int = 0) -> float:
        return log_evidence(squares + known, numbers, counts)

    valid = {found: fit for found, fit in fits.items() if fit.stands and all(
        evidence(fit.held_squares) > evidence(fits[fewer].held_squares)
        for fewer in _without_one(found))}
    evidences = {found: evidence(fit.squares, len(fit.values)) for found, fit in valid.items()}
    best = max(evidences, key=lambda found: evidences[found])
    accepted = np.minimum(NEAR_NOISE**2, valid[best].squares)
    shares = _shares({_joined(found): value for found, value in evidences.items()}
                     | {SOMETHING_ELSE: evidence(
                         accepted, len(valid[best].values) + 2)})
    return _diagnosis(identified, data, errors, best, valid, shares)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Effects fitted to a recording."""

    values: FloatArray
    deviations: FloatArray
    squares: FloatArray
    held_squares: FloatArray
    """Mean square errors of each axis in squared tolerances: of the fit to all rows, and on
    held-out rows of the fit to the others, (n,)."""
    contributions: FloatArray
    """RMS contribution of each effect in tolerances."""
    stands: bool
    """Whether each effect clearly differs from zero and from errors of the model."""

    @property
    def mean_square(self) -> float:
        """Return the mean square error over all axes."""
        return float(np.mean(self.squares))


def _fitted(errors: DiagnosedErrors, effects: Sequence[AxisEffect]) -> _Fit:
    values = errors.values(effects, joined_values(np.array(each.start) for each in effects),
                           np.ones_like(errors.fitted))
    residual, columns = errors.linearised(effects, values)
    held = errors.residual(effects, errors.values(effects, values, errors.fitted))[~errors.fitted]
    deviations = np.zeros(len(values))
    if effects:
        covariance = clustered_covariance(
            columns.reshape(-1, len(values)), residual.ravel(),
            np.repeat(errors.stretch, residual.shape[1]))
        # The known error of the model may have the course of the effect.
        known = np.mean(columns**2 / errors.known_squares[..., None], axis=0)
        deviations = np.sqrt(np.diag(covariance) + 1.0 / np.sum(known, axis=0))
    contributions, stands = [], True
    for effect, numbers in zip(effects, by_effect(effects, np.arange(len(values))), strict=True):
        linear = numbers[effect.linear]
        contributions.append(np.sqrt(np.mean((columns[..., linear] @ values[linear]) ** 2)))
        stands &= _stands(errors.model, effect, values[numbers], deviations[numbers])
    return _Fit(values, deviations, np.mean(residual**2, axis=0), np.mean(held**2, axis=0),
                np.array(contributions), stands)


def _without_one(found: tuple[AxisEffect, ...]) -> list[tuple[AxisEffect, ...]]:
    """Return the sets of effects that lack one of these."""
    return [tuple(each for each in found if each != dropped) for dropped in found]


def _shares(evidence: dict[str, float]) -> dict[str, float]:
    """Return the probability of each alternative, in descending order."""
    shares = softmax(list(evidence.values())).tolist()
    return dict(sorted(zip(evidence, shares, strict=True), key=lambda each: -each[1]))


def _stands(model: CoupledModel, effect: AxisEffect, values: FloatArray,
            off: FloatArray) -> bool:
    """Return whether an effect clearly differs from zero and from errors of the model."""
    # A tone from elsewhere looks like a mode without damping.
    if np.isclose(values, effect.bounds(model), rtol=AT_BOUND, atol=0.0).any():
        return False
    away = SIGNIFICANT * off
    differs = np.abs(values[effect.linear]) >= away[effect.linear]
    return bool(differs.any()) and not effect.overlaps(model, values, away)


def _label(entry: dict[str, Any]) -> str:
    parameters = entry["parameters"]
    return AxisEffect(entry["name"], parameters["axis"], parameters.get("from_axis", "")).label


def _diagnosis(identified: IdentifiedAxes, data: AxesRecording | AxesResponse,
               errors: DiagnosedErrors, best: tuple[AxisEffect, ...],
               valid: dict[tuple[AxisEffect, ...], _Fit],
               shares: dict[str, float]) -> AxesDiagnosis:
    """Return the diagnosis that names the best set, unless it would be a guess."""
    unexplained = shares[SOMETHING_ELSE] >= BELIEVED
    helps = ", ".join(effect.label for effect in best)
    if unexplained and valid[best].mean_square > GUESS * valid[()].mean_square:
        best = ()
    fit = valid[best]
    extended = _extended(identified, errors.extended(best, fit.values), data, best, fit)
    after = errors.reported(extended.model)
    others = {each.label: next(one.label for one in best if one not in found)
              for found in valid for each in found
              if each not in best and set(best) - set(found)
              and shares[_joined(found)] >= ALTERNATIVE}
    noise_um = dict(zip(data.axes, errors.noise_um.tolist(), strict=True))
    remains = [f"{axis}: {error['rms_um']:.3g} {errors.unit} remain, "
               f"{error['rms_um'] / noise_um[axis]:.3g} times the noise"
               for axis, error in after.items()]
    if helps:
        remains.append(f"most helps: {helps}")
    return AxesDiagnosis(
        "unexplained" if unexplained else "explained" if best else "none", _entries(best, fit),
        extended, errors.given, after, noise_um,
        {name: share for name, share in shares.items() if share >= LISTED}, others,
        {f"gain[{axis}]": errors.not_shown for axis in data.axes if errors.not_shown},
        "; ".join(remains) if unexplained else "")


def _extended(identified: IdentifiedAxes, model: CoupledModel, data: AxesRecording | AxesResponse,
              effects: Sequence[AxisEffect], fit: _Fit) -> IdentifiedAxes:
    """Return what is known of a model with effects; the given one if there are none."""
    if not effects:
        return identified
    late_s = identified.delays_s.copy()
    poles, residues = identified.pole_deviations_rad_per_s, identified.residue_deviations_um_per_v
    for effect, values, off in zip(effects, by_effect(effects, fit.values),
                                   by_effect(effects, fit.deviations), strict=True):
        if effect.name == "delay":
            late_s[data.axes.index(effect.axis)] += values[0]
        if isinstance(effect, ModeOfAxis):
            pole_off, residue_off = effect.deviations(model, values, off)
            poles = np.concatenate([[pole_off], poles])
            residues = np.concatenate([residue_off, residues])
    coupling = identified.coupling
    return replace(
        identified, model=model, delays_s=late_s, pole_deviations_rad_per_s=poles,
        residue_deviations_um_per_v=residues,
        coupling=replace(coupling, gain_um_per_v=model.response(coupling.frequency_hz)),
        recordings=[*identified.recordings, {"path": data.name, "sha256": data.sha256}])


def _entries(effects: Sequence[AxisEffect], fit: _Fit) -> list[dict[str, Any]]:
    """Return the entries of effects in `verdict.json`, the strongest first."""
    residual, entries = np.sqrt(fit.mean_square), []
    values, deviations = (by_effect(effects, each) for each in (fit.values, fit.deviations))
    for number in np.argsort(-fit.contributions):
        effect = effects[number]
        other = {"from_axis": effect.from_axis} if effect.from_axis else {}
        without = np.hypot(residual, fit.contributions[number])
        entries.append({
            "name": effect.name,
            "parameters": {"axis": effect.axis, **other, **dict(zip(
                effect.parameters, values[number].tolist(), strict=True))},
            "standard_deviations": dict(zip(
                effect.parameters, deviations[number].tolist(), strict=True)),
            "error_reduction_percent": float(100.0 * (1.0 - residual / without))})
    return entries


def _joined(effects: Sequence[AxisEffect]) -> str:
    return "+".join(effect.label for effect in effects) or "none"
