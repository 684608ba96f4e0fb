# SPDX-License-Identifier: BSD-3-Clause
"""Find what a model of several axes lacks to explain a recording."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from piezo_common.arrays import BoolArray, FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_common.text_file import replace_json
from piezo_identification.axes.axis_effects import AxisEffect, ModeOfAxis, all_effects
from piezo_identification.axes.mode_search import guessed
from piezo_identification.axes.predict_axes import (
    circumstances_of,
    decays,
    predict_several_axes,
    rows_apart,
    simulated_um,
)
from piezo_identification.conditioning.sensor_noise import (
    noise_floor_um,
    repeated_period,
    sensor_noise_um,
)
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.diagnosis.joint.probabilities import ALTERNATIVE, LISTED
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.evidence import independent_errors, log_evidence
from piezo_identification.fitting.regression import SETTINGS
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import save_axes_model
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

ACCEPTED = 3.0
"""RMS of a residual, in tolerances, that passes as noise: the accuracy that identification aims
at."""

GUESSED = 0.5
"""Fraction of the power of an unexplained residual below which effects would be guesses."""

DEVIATIONS = 3.0
"""Standard deviations by which a named effect differs from zero."""

MOST_STEPS = 8
"""Largest number of Gauss-Newton steps of a fit; only delays and modes are not linear."""

LAST_STEP = 1e-3
"""Change of the displacement, in tolerances, by the last step of a fit."""


@dataclass(frozen=True, eq=False, repr=False)
class AxesDiagnosis:
    """What a model of several axes lacks to explain a recording."""

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
    left: str
    """Sentence on the residual if it is more than noise."""

    def document(self) -> dict[str, Any]:
        """Return the content of `verdict.json`."""
        because = {name: f"explains the recording like {other}" for name, other
                   in self.confounded_with.items()}
        return {"verdict": self.verdict, "effects": self.effects, "before": self.before,
                "after": self.after, "noise_floor_um": self.noise_floor_um,
                "not_decidable": list(because), "not_decidable_because": because,
                "not_told_from": self.confounded_with, "left": self.left,
                "probabilities": self.probabilities}

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
        notes += [f"not decidable: {name} explains the recording like {other}"
                  for name, other in self.confounded_with.items()]
        return SummaryTable(f"verdict: {self.verdict}", ("", "value", "std. dev."), rows,
                            (*notes, *filter(None, [self.left])))

    def __repr__(self) -> str:
        return repr(self.summary())


def diagnose_axes(identified: IdentifiedAxes, recording: AxesRecording) -> AxesDiagnosis:
    """Find the effect, or the two effects, that a model lacks to explain a recording.

    Raises
    ------
    RecordingError
        If the recording is of other axes, of a shorter sample period, too short, or without motion,
        or if a displacement is constant.
    """
    if not np.ptp(recording.voltage_v, axis=0).any():
        raise RecordingError(f"no axis of {recording.name} moves: give a recording of motion")
    for axis, resting in zip(recording.axes, np.ptp(recording.displacement_um, axis=0) == 0.0,
                             strict=True):
        if resting:
            raise RecordingError(f"the displacement of {axis} in {recording.name} is constant: "
                                 "give a recording with the sensors of all axes")
    if len(recording.voltage_v) < SPLIT.held_out * SPLIT.stretches:
        raise RecordingError(f"{recording.name} has {len(recording.voltage_v)} rows: give "
                             f"{SPLIT.held_out * SPLIT.stretches} or more")
    before = _errors(identified.model, recording)
    errors = _Errors(identified, recording)
    seen = [each for each in [*all_effects(recording.axes), *errors.modes(identified)]
            if errors.linearised((each,), np.array(each.start))[1].any()]
    fits = {found: _fitted(errors, found) for found in [(), *((each,) for each in seen)]}
    best_first = sorted((each for each in seen if fits[each,].stands or not isinstance(
        each, ModeOfAxis)), key=lambda each: fits[each,].mean_square)
    fits |= {found: _fitted(errors, found) for found in combinations(best_first, 2)
             if best_first.index(found[0]) < CRITERIA.alternatives}
    least = min(fits, key=lambda found: fits[found].mean_square)
    counts = np.array([
        independent_errors(column) for column in errors.residual(least, fits[least].values).T])

    def evidence(squares: FloatArray, numbers: int = 0) -> float:
        return log_evidence(squares + errors.known_squares, numbers, counts)

    valid = {found: fit for found, fit in fits.items() if fit.stands and all(
        evidence(fit.held_squares) > evidence(fits[fewer].held_squares)
        for fewer in _without_one(found))}
    evidences = {found: evidence(fit.squares, len(fit.values)) for found, fit in valid.items()}
    best = max(evidences, key=lambda found: evidences[found])
    accepted = np.minimum(ACCEPTED**2, valid[best].squares)
    shares = _shares({_joined(found): value for found, value in evidences.items()}
                     | {"something_else": evidence(
                         accepted, len(valid[best].values) + 2)})
    return _diagnosis(identified, recording, errors, before, best, valid, shares)


class _Errors:
    """Errors of changed models in a recording, in tolerances: noise and known error of the model.

    Offset and decays from before the recording are projected out.
    """

    def __init__(self, identified: IdentifiedAxes, recording: AxesRecording) -> None:
        model = self._model = identified.model
        self.circumstances = circumstances_of(model, recording)
        self.recording = self._driven(recording)
        rows = np.arange(len(recording.voltage_v))
        self.stretch = rows * SPLIT.stretches // rows.size
        self.fitted = self.stretch % SPLIT.held_out != SPLIT.held_out // 2
        before = decays(model, recording)
        self._nuisance = np.linalg.svd(np.column_stack([
            np.ones(rows.size), before - before.mean(axis=0)]), full_matrices=False)[0]
        moves_v = np.linalg.norm(recording.voltage_v - recording.voltage_v[0], axis=1)
        residual_um = self._residual_um(model)
        # The residual of a wrong model may contain more at high frequencies than the motion.
        self.noise_um = np.array([
            min(sensor_noise_um(measured, moves_v, residual, repeated_period(moves_v)),
                noise_floor_um(measured))
            for measured, residual in zip(recording.displacement_um.T, residual_um.T, strict=True)])
        stated = np.array([identified.errors.get(axis, {}).get("e_y_percent", 0.0)
                           for axis in recording.axes])
        known_um = stated / 100.0 * np.std(recording.displacement_um, axis=0)
        self.model_um = np.hypot(
            SETTINGS.model_tolerance * np.ptp(recording.displacement_um, axis=0),
            np.sqrt(np.maximum(known_um**2 - self.noise_um**2, 0.0)))
        self.tolerance_um = np.hypot(self.noise_um, self.model_um)
        self.known_squares = (self.model_um / self.tolerance_um) ** 2

    def _driven(self, recording: AxesRecording) -> AxesRecording:
        """Return the recording with the drive of the modes instead of the voltage."""
        model, how, periods = self._model, self.circumstances, recording.periods or 1
        voltage_v = recording.voltage_v.reshape(periods, -1, len(model.axes)).mean(axis=0)
        if rows_apart(model, recording) != 1.0:
            model = model.at_period(recording.sample_period_s, not how.is_held)
        drive_v = model.drive_v(voltage_v, bool(recording.periods), how.pasts, not how.is_held)
        return replace(recording, voltage_v=np.tile(drive_v, (periods, 1)))

    def _residual_um(self, model: CoupledModel) -> FloatArray:
        residual_um = self.recording.displacement_um - simulated_um(
            replace(model, actuators=()), self.recording, self.circumstances)
        projected: FloatArray = residual_um - self._nuisance @ (self._nuisance.T @ residual_um)
        return projected

    def modes(self, identified: IdentifiedAxes) -> list[ModeOfAxis]:
        """Return the mode of each moving axis that explains most of the errors."""
        model, driven = self._model, self.recording
        latency_s = model.latency_samples * model.sample_period_s
        delays_s = np.where(np.isfinite(identified.delay_deviations_s), identified.delays_s,
                            latency_s)
        return [guessed(ModeOfAxis("vibration_mode", axis, "", model.axes,
                                   tuple((delays_s - latency_s).tolist())),
                        driven, self._residual_um(model), self.tolerance_um, delays_s)
                for axis, column in zip(model.axes, driven.voltage_v.T, strict=True)
                if np.ptp(column)]

    def stands(self, effect: AxisEffect, values: FloatArray, off: FloatArray) -> bool:
        """Return whether an effect clearly differs from zero and from errors of the model."""
        away = DEVIATIONS * off
        differs = np.abs(values[effect.linear]) >= away[effect.linear]
        return bool(differs.any()) and not effect.overlaps(self._model, values, away)

    def extended(self, effects: Sequence[AxisEffect], values: FloatArray) -> CoupledModel:
        """Return the model with effects."""
        return reduce(lambda model, each: each[0].applied(model, each[1]),
                      zip(effects, _by_effect(effects, values), strict=True), self._model)

    def residual(self, effects: Sequence[AxisEffect], values: FloatArray) -> FloatArray:
        """Return the errors with effects, (N, n)."""
        residual: FloatArray = self._residual_um(self.extended(effects, values)) / self.tolerance_um
        return residual

    def linearised(self, effects: Sequence[AxisEffect],
                   values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors, (N, n), and the derivatives of the displacement, (N, n, p)."""
        unmoved, columns = self.residual(effects, values), []
        for number, step in enumerate(_joined_values(
                effect.steps(self._model, own) for effect, own in zip(
                    effects, _by_effect(effects, values), strict=True))):
            moved = values.copy()
            moved[number] += step
            columns.append((unmoved - self.residual(effects, moved)) / step)
        return unmoved, (np.stack(columns, axis=-1) if columns
                         else np.zeros((*unmoved.shape, 0)))

    def values(self, effects: Sequence[AxisEffect], values: FloatArray,
               rows: BoolArray) -> FloatArray:
        """Return the parameters that fit some rows best, (p,), from initial values."""
        for _ in range(MOST_STEPS if effects else 0):
            residual, columns = self.linearised(effects, values)
            columns = columns[rows].reshape(-1, len(values))
            step = np.linalg.lstsq(columns, residual[rows].ravel(), rcond=1e-12)[0]
            values = _joined_values(
                effect.within_bounds(self._model, own) for effect, own in zip(
                    effects, _by_effect(effects, values + step), strict=True))
            if np.sqrt(np.mean((columns @ step) ** 2)) < LAST_STEP:
                break
        return values


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


def _fitted(errors: _Errors, effects: Sequence[AxisEffect]) -> _Fit:
    values = errors.values(effects, _joined_values(np.array(each.start) for each in effects),
                           np.ones_like(errors.fitted))
    residual, columns = errors.linearised(effects, values)
    held = errors.residual(effects, errors.values(effects, values, errors.fitted))[~errors.fitted]
    deviations = np.zeros(len(values))
    if effects:
        covariance = clustered_covariance(
            columns.reshape(-1, len(values)), residual.ravel(),
            np.repeat(errors.stretch, residual.shape[1]))
        # The known error of the model may have the course of the effect.
        known = np.mean(columns**2, axis=0) / errors.known_squares[:, None]
        deviations = np.sqrt(np.diag(covariance) + 1.0 / np.sum(known, axis=0))
    contributions, stands = [], True
    for effect, numbers in zip(effects, _by_effect(effects, np.arange(len(values))), strict=True):
        linear = numbers[effect.linear]
        contributions.append(np.sqrt(np.mean((columns[..., linear] @ values[linear]) ** 2)))
        stands &= errors.stands(effect, values[numbers], deviations[numbers])
    return _Fit(values, deviations, np.mean(residual**2, axis=0), np.mean(held**2, axis=0),
                np.array(contributions), stands)


def _by_effect(effects: Sequence[AxisEffect], values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the part of the values that belongs to each effect."""
    return np.split(values, np.cumsum([len(effect.parameters) for effect in effects]))[:-1]


def _joined_values(parts: Iterable[FloatArray]) -> FloatArray:
    return np.concatenate([np.zeros(0), *parts])


def _without_one(found: tuple[AxisEffect, ...]) -> list[tuple[AxisEffect, ...]]:
    """Return the sets of effects that lack one of these."""
    return [tuple(each for each in found if each != dropped) for dropped in found]


def _shares(evidence: dict[str, float]) -> dict[str, float]:
    """Return the probability of each alternative, in descending order."""
    shares = softmax(list(evidence.values())).tolist()
    return dict(sorted(zip(evidence, shares, strict=True), key=lambda each: -each[1]))


def _errors(model: CoupledModel, recording: AxesRecording) -> dict[str, dict[str, float]]:
    prediction = predict_several_axes(model, recording)
    rms_um = np.std(prediction.measured_um - prediction.simulated_um, axis=0)
    return {axis: {"rms_um": float(rms_um[recording.axes.index(axis)]), "e_y_percent": error}
            for axis, error in prediction.e_y_percent().items()}


def _label(entry: dict[str, Any]) -> str:
    parameters = entry["parameters"]
    return AxisEffect(entry["name"], parameters["axis"], parameters.get("from_axis", "")).label


def _diagnosis(identified: IdentifiedAxes, recording: AxesRecording, errors: _Errors,
               before: dict[str, dict[str, float]], best: tuple[AxisEffect, ...],
               valid: dict[tuple[AxisEffect, ...], _Fit],
               shares: dict[str, float]) -> AxesDiagnosis:
    """Return the diagnosis that names the best set, unless it would be a guess."""
    unexplained = shares["something_else"] >= 0.5
    helps = ", ".join(effect.label for effect in best)
    if unexplained and valid[best].mean_square > GUESSED * valid[()].mean_square:
        best = ()
    fit = valid[best]
    extended = _extended(identified, errors.extended(best, fit.values), recording, best, fit)
    after = _errors(extended.model, recording)
    others = {each.label: next(one.label for one in best if one not in found)
              for found in valid for each in found
              if each not in best and set(best) - set(found)
              and shares[_joined(found)] >= ALTERNATIVE}
    noise_um = dict(zip(recording.axes, errors.noise_um.tolist(), strict=True))
    remains = [f"{axis}: {error['rms_um']:.3g} um remain, {error['rms_um'] / noise_um[axis]:.3g} "
               "times the noise" for axis, error in after.items()]
    if helps:
        remains.append(f"most helps: {helps}")
    return AxesDiagnosis(
        "unexplained" if unexplained else "explained" if best else "none", _entries(best, fit),
        extended, before, after, noise_um,
        {name: share for name, share in shares.items() if share >= LISTED}, others,
        "; ".join(remains) if unexplained else "")


def _extended(identified: IdentifiedAxes, model: CoupledModel, recording: AxesRecording,
              effects: Sequence[AxisEffect], fit: _Fit) -> IdentifiedAxes:
    """Return what is known of a model with effects; the given one if there are none."""
    if not effects:
        return identified
    late_s = identified.delays_s.copy()
    poles, residues = identified.pole_deviations_rad_per_s, identified.residue_deviations_um_per_v
    for effect, values, off in zip(effects, _by_effect(effects, fit.values),
                                   _by_effect(effects, fit.deviations), strict=True):
        if effect.name == "delay":
            late_s[recording.axes.index(effect.axis)] += values[0]
        if isinstance(effect, ModeOfAxis):
            pole_off, residue_off = effect.deviations(model, values, off)
            poles = np.concatenate([[pole_off], poles])
            residues = np.concatenate([residue_off, residues])
    coupling = identified.coupling
    return replace(
        identified, model=model, delays_s=late_s, pole_deviations_rad_per_s=poles,
        residue_deviations_um_per_v=residues,
        coupling=replace(coupling, gain_um_per_v=model.response(coupling.frequency_hz)),
        recordings=[*identified.recordings, {"path": recording.name, "sha256": recording.sha256}])


def _entries(effects: Sequence[AxisEffect], fit: _Fit) -> list[dict[str, Any]]:
    """Return the entries of effects in `verdict.json`, the strongest first."""
    residual, entries = np.sqrt(fit.mean_square), []
    values, deviations = (_by_effect(effects, each) for each in (fit.values, fit.deviations))
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
