# SPDX-License-Identifier: BSD-3-Clause
"""The evidence of a model with effects on several recordings, and its derivatives.

With Gaussian errors of unknown variance in each recording r, and a prior of the model's changes x,
the function ::

    -ln p = n / 2 sum_r ln(m_r + l_r^2) + |x|^2 / 2

is minimised. Here m_r is the mean square error on the fitted rows, l_r the accuracy of a good
model, and n the number of independent errors of a recording. The offset and initial creep of each
recording are projected out. For recordings of the identification, so are the parameters of
recurring effects that differ between recordings, such as the phase of a disturbance. The logarithm
is concave: a sum of squares with the weights n / (m_r + l_r^2) at some m_r has the same gradient,
and a step reduces it by no more than the function itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from piezo_common.arrays import BoolArray, FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.estimators.estimate import scaled_inverse
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.fitting.evidence import INDEPENDENT
from piezo_identification.fitting.free_parameters import (
    changed_model,
    decay_sensitivities,
    free_sensitivities,
    lowest_changes,
    physical_count,
)
from piezo_identification.fitting.measured_response import MeasuredResponse
from piezo_identification.fitting.regression import accuracies_um
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, fitted_values, with_fitted_values

LONGEST_STEP = 5.0
"""Largest change of a model parameter in one step, in prior widths."""

DERIVATIVE_STEP = 1e-7
"""Step of the numerical derivative by a parameter of an effect; relative for values above one."""

OfEffects = Mapping[tuple[int, Effect, int], FloatArray]
"""Derivatives by the parameters of effects, (n,), by recording, effect, and number of parameter."""

KEPT = 256
"""Number of cached effects: those of the points of a few fits and of the steps from them."""


class RecordingBefore(SimulatedRecording):
    """A recording made before some effects appeared, and at another time than the others."""

    later: frozenset[str] = frozenset()

    @classmethod
    def of(cls, part: SimulatedRecording, later: frozenset[str]) -> "RecordingBefore":
        """Return a simulated recording marked as made before the named effects appeared."""
        before = cls.__new__(cls)
        vars(before).update(vars(part))
        before.later = later
        return before

    def simulate(self, effects: Sequence[Effect] = (), quick: Sequence[Effect] = (),
                 rows: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the displacement with the effects that this recording contains."""
        return super().simulate(self.there(effects), self.there(quick), rows)

    def there(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects of the stage that had appeared when the recording was made."""
        return tuple(effect for effect in effects
                     if effect.of_the_stage and effect.name not in self.later)

    def recurrences(self, effects: Sequence[Effect], rows: NDArray[np.intp]) -> list[FloatArray]:
        """Return the regressors of recurring effects specific to this recording, (n, k)."""
        time_s = self.time_s
        return [effect.recurrence(time_s[rows], time_s[-1]) for effect in effects
                if effect.recurs and effect.name not in self.later]


def simulated_by(dataset: Dataset, model: StageModel, new_count: int,
                 later: frozenset[str]) -> Dataset:
    """Simulate another model on the same rows.

    The first `new_count` recordings contain the effects named in `later`, which appeared after the
    other recordings.
    """
    simulated = side_by_side(lambda part: part.with_model(model), dataset.simulated)
    return replace(dataset, model=model, simulated=tuple(
        part if number < new_count else RecordingBefore.of(part, later)
        for number, part in enumerate(simulated)))


def _projected_out(part: SimulatedRecording, rows: NDArray[np.intp],
                   effects: Sequence[Effect]) -> FloatArray:
    """Return nuisance regressors and those of recurring effects of a recording, (n, k)."""
    own = part.recurrences(effects, rows) if isinstance(part, RecordingBefore) else []
    return np.column_stack([part.nuisance_regressors(rows, effects), *own])


@lru_cache(maxsize=KEPT)
def _with_values(effect: Effect, values: tuple[float, ...]) -> Effect:
    """Return an effect with fitted values, cached: a derivative changes one effect of several."""
    return with_fitted_values(effect, np.array(values))


class _Nuisance:
    """Regressors to be projected out, and their factors, with which many signals are projected.

    The regressors are (n, k). Only the rows marked in `good`, (n,), determine the coefficients.
    """

    def __init__(self, regressors: FloatArray, good: BoolArray) -> None:
        self.regressors, self._good = regressors, good
        self._basis, triangle = np.linalg.qr(regressors[good])
        # The triangle has the singular values of the long matrix.
        self.inverse = np.linalg.pinv(triangle, rcond=1e-12)

    def sizes(self, values: FloatArray) -> FloatArray:
        """Return the coefficients that fit values at all rows best, (k,) or (k, m)."""
        return np.asarray(self.inverse @ (self._basis.T @ values[self._good]))

    def projected_out_of(self, values: FloatArray) -> FloatArray:
        """Return values at all rows without their nuisance part."""
        return values - self.regressors @ self.sizes(values)


@dataclass(frozen=True, eq=False)
class _Point:
    """Simulation at some unknowns, and its error with the nuisance regressors projected out."""

    dataset: Dataset
    effects: tuple[Effect, ...]
    nuisance: list[_Nuisance]
    sizes: list[FloatArray]
    residual_um: list[FloatArray]

    of_responses: list[FloatArray]
    """Weighted errors of the responses."""


class JointErrors:
    """Errors of a model with effects as a function of changes of their parameters.

    It is a `levenberg_marquardt.Objective`.

    Parameters
    ----------
    dataset : Dataset
        Data simulated with the unchanged model, without effects.
    fitted, good : (r,) array of bool
        Rows that are fitted, and rows that determine offset and initial creep. The latter include
        held-out rows: otherwise initial creep that shows only there would be undetermined.
    new_count : int
        See `simulated_by`.
    later : frozenset of str
        Names of effects that are only in the new recordings.
    held : sequence of piezo_models.effects.effect.Effect
        Further effects, which are not fitted.
    pieces_um : sequence of sequences of (N,) array, optional
        Results of `free_parameters.piece_outputs_um` for each recording: the same for all fits.
    of_pieces_um : dict of int to (n, pieces) array, optional
        Change of the displacement with each piece, by recording. Entries present are reused from a
        similar model; missing ones are computed and added.
    of_effects_um : dict, optional
        Results of `of_effects_um` of a similar fit. A parameter of an effect that still has the
        same values takes its derivative from there, until the errors are forgotten.
    columns : (r, n) array, optional
        Derivatives of the displacement by the unknowns, in um, used at all points; by default they
        are computed.
    hysteresis_width : float
        Prior width of the changes of the hysteresis, relative to that of `free_parameters`.
    physical_width : float
        Prior width of the changes of creep and dynamics, relative to that of `free_parameters`.
    responses : sequence of MeasuredResponse
        Frequency responses that the model is fitted to, besides the recordings.
    are_all_fitted : bool
        Fit the held-out frequencies of the responses, too.
    """

    def __init__(self, dataset: Dataset, fitted: BoolArray, good: BoolArray, new_count: int,
                 effects: Sequence[Effect], later: frozenset[str],
                 held: Sequence[Effect] = (),
                 pieces_um: Sequence[Sequence[FloatArray]] | None = None,
                 columns: FloatArray | None = None,
                 hysteresis_width: float = 1.0, physical_width: float = 1.0,
                 of_pieces_um: dict[int, FloatArray] | None = None,
                 of_effects_um: OfEffects | None = None,
                 responses: Sequence[MeasuredResponse] = (),
                 are_all_fitted: bool = False) -> None:
        self._of_pieces_um, self._responses = of_pieces_um, tuple(responses)
        self._of_effects_um = of_effects_um or {}
        self._at_frequencies = [each.for_estimation | are_all_fitted for each in responses]
        self.dataset, self.new_count, self.later = dataset, new_count, later
        self.count = dataset.regressors.shape[1] - dataset.nuisance_count
        self._fitted = [fitted[mask] for mask in dataset.masks()]
        self._good = [good[mask] for mask in dataset.masks()]
        self._effects, self._held = tuple(effects), tuple(held)
        numbers = [fitted_values(effect, dataset.extent) for effect in effects]
        self._ends = self.count + np.cumsum([0, *(values.size for values, _, _ in numbers)])
        lows, highs = ([bounds[index] for bounds in numbers] for index in (1, 2))
        free = np.full(self.count, np.inf)
        least, self._prior = -free, np.full(self.count, 1.0 / physical_width)
        self._physical = min(physical_count(dataset.model), self.count)
        if self.count > self._physical:
            least[self._physical :] = lowest_changes(dataset.model.hysteresis)
            self._prior[self._physical :] = 1.0 / hysteresis_width
        self.low, self.high = np.concatenate([least, *lows]), np.concatenate([free, *highs])
        self.longest = np.full(self.low.size, np.inf)
        self.longest[: self.count] = LONGEST_STEP
        self.accuracy_um = np.append(
            accuracies_um(dataset), [each.accuracy for each in responses])
        self._counts = np.array([
            *[INDEPENDENT] * len(dataset.simulated), *(each.independent for each in responses)])
        self._own_count = [part.nuisance_regressors(rows[:1]).shape[1] for part, rows in zip(
            dataset.simulated, dataset.rows, strict=True)]
        self._pieces_um = pieces_um
        self._points: dict[bytes, _Point] = {}
        self._columns: tuple[bytes, list[FloatArray]] = b"", []
        self._columns_are_given = columns is not None
        if columns is not None:
            self._columns = b"", [columns[mask] for mask in dataset.masks()]

    def vector(self, changes: FloatArray, effects: Sequence[Effect]) -> FloatArray:
        """Return the vector of unknowns for changes of the model and effects, (n,)."""
        numbers = [fitted_values(effect, self.dataset.extent)[0] for effect in effects]
        return np.clip(np.concatenate([changes, *numbers]), self.low, self.high)

    def effects_at(self, vector: FloatArray) -> tuple[Effect, ...]:
        """Return the fitted effects at some unknowns, followed by the held effects."""
        return (*(_with_values(effect, tuple(vector[start:end].tolist()))
                  for effect, (start, end) in zip(
                      self._effects, pairwise(self._ends), strict=True)), *self._held)

    def dataset_at(self, vector: FloatArray) -> Dataset:
        """Return the data set simulated with the changed model, with its nuisance regressors."""
        point = self._at(vector)
        nuisance = block_diag(*(each.regressors for each in point.nuisance))
        changes = self.dataset.regressors[:, self.dataset.nuisance_count :]
        if self._columns[1]:
            # Derivatives of the last step, close to the result.
            changes = np.vstack(self._columns[1])[:, : self.count]
        return replace(point.dataset, regressors=np.hstack([nuisance, changes]),
                       nuisance_count=nuisance.shape[1])

    @property
    def columns_of_effects(self) -> FloatArray | None:
        """Return the last derivatives by the effect parameters, in um, (r, p); None before any."""
        columns = [each[:, self.count :] for each in self._columns[1]]
        return np.vstack(columns) if columns else None

    def of_effects_um(self, vector: FloatArray) -> OfEffects:
        """Return the derivatives of the displacement by the parameters of the effects, in um."""
        columns = self._columns_at(vector)
        return {(index, *self._parameter_at(vector, number)): columns[index][:, number]
                for number in range(self.count, vector.size) for index in range(len(columns))}

    def recurrence_count(self, vector: FloatArray) -> int:
        """Return how many parameters of recurring effects are projected out."""
        return sum(
            signals.shape[1] for part, rows in zip(
                self._at(vector).dataset.simulated, self.dataset.rows, strict=True)
            if isinstance(part, RecordingBefore)
            for signals in part.recurrences(self.effects_at(vector), rows[:1]))

    def squares_um2(self, vector: FloatArray) -> FloatArray:
        """Return the mean square error on the fitted rows of each recording and response, (R,)."""
        return np.array([np.mean(each**2) for each, _ in self.residual_um(vector)])

    def value(self, vector: FloatArray) -> float:
        """Return the function to minimise; infinite where there is no finite simulation."""
        try:
            squares = self.squares_um2(vector) + self.accuracy_um**2
        except np.linalg.LinAlgError:  # such as a filter much slower than its samples
            return np.inf
        changes = self._prior * vector[: self.count]
        against = float(0.5 * self._counts @ np.log(squares) + 0.5 * changes @ changes)
        return against if np.isfinite(against) else np.inf

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted errors and their derivatives, followed by those of the prior."""
        return self._weighted(vector, self._columns_at(vector))

    def covariance(self, vector: FloatArray) -> FloatArray | None:
        """Return the covariance of the effect parameters, from the last derivatives.

        Errors may be correlated within a stretch of a recording.
        """
        if not self._columns[1] or vector.size == self.count:
            return None
        residual, jacobian = self._weighted(vector, self._columns[1])
        return clustered_covariance(
            jacobian, residual, self._stretch())[self.count :, self.count :]

    def covariance_of_all(self, vector: FloatArray, physical: int) -> FloatArray:
        """Return the covariance, (n, n), of all unknowns, without the prior of the first ones.

        The first `physical` unknowns, creep and dynamics, are those whose prior is dropped; effects
        have no prior. Errors may be correlated within a stretch of a recording. Unknowns that the
        recordings do not determine have infinite variance.
        """
        residual, jacobian = self._weighted(vector, self._columns_at(vector, is_exact=True))
        stretch = self._stretch()
        jacobian[stretch.size : stretch.size + physical] = 0.0
        covariance = clustered_covariance(jacobian, residual, stretch)
        unknown = scaled_inverse(jacobian)[1]
        covariance[unknown, :] = covariance[:, unknown] = 0.0
        covariance[unknown, unknown] = np.inf
        return covariance

    def residual_um(self, vector: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the residuals of the fitted and of the held-out rows of each recording.

        Those of the responses follow, in the unit of their weighted gain.
        """
        point = self._at(vector)
        return [*((each_um[fitted], each_um[good & ~fitted]) for each_um, fitted, good in zip(
            point.residual_um, self._fitted, self._good, strict=True)),
            *((each[fitted], each[~fitted]) for each, fitted in zip(
                point.of_responses, self._at_frequencies, strict=True))]

    def forget(self) -> None:
        """Drop the simulations, which are many times as large as the recordings.

        A search keeps every fit that it has tried. The simulations are recomputed when needed.
        """
        self._points, self._columns, self._of_effects_um = {}, (b"", []), {}
        self.dataset = simulated_by(
            self.dataset, self.dataset.model, self.new_count, self.later)

    def forget_pieces(self) -> None:
        """Drop what is shared with other fits of the hysteresis; it is recomputed when needed."""
        self._pieces_um = self._of_pieces_um = None

    def _weighted(self, vector: FloatArray,
                  columns: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        point = self._at(vector)
        squares = self.squares_um2(vector) + self.accuracy_um**2
        sizes = [np.count_nonzero(fitted) for fitted in (*self._fitted, *self._at_frequencies)]
        weights, of_responses = np.split(
            np.sqrt(self._counts / (sizes * squares)), [len(self._fitted)])
        residuals, jacobians = [], []
        for index, (fitted, weight) in enumerate(zip(self._fitted, weights, strict=True)):
            remaining = point.nuisance[index].projected_out_of(columns[index])
            moved = self._moved_with_rates(point, index)
            remaining[:, : moved.shape[1]] += moved
            residuals.append(weight * point.residual_um[index][fitted])
            jacobians.append(-weight * remaining[fitted])
        for response, residual, fitted, weight in zip(
                self._responses, point.of_responses, self._at_frequencies, of_responses,
                strict=True):
            residuals.append(weight * residual[fitted])
            jacobians.append(weight * self._of_response(response, residual, vector)[fitted])
        prior = np.eye(self.count, vector.size) * self._prior[:, None]
        return (np.concatenate([*residuals, self._prior * vector[: self.count]]),
                np.vstack([*jacobians, prior]))

    def _at(self, vector: FloatArray) -> _Point:
        """Simulate the model and the effects at some unknowns; the last two points are cached."""
        key = vector.tobytes()
        if key not in self._points:
            dataset = simulated_by(
                self.dataset, changed_model(self.dataset.model, vector[: self.count]),
                self.new_count, self.later)
            effects = self.effects_at(vector)

            def of_recording(index: int) -> tuple[_Nuisance, FloatArray, FloatArray]:
                part, rows = dataset.simulated[index], dataset.rows[index]
                difference_um = part.measured_um[rows] - part.simulate(effects, rows=rows)
                nuisance = _Nuisance(_projected_out(part, rows, effects), self._good[index])
                sizes = nuisance.sizes(difference_um)
                return nuisance, sizes, difference_um - nuisance.regressors @ sizes

            found = side_by_side(of_recording, range(len(dataset.rows)))
            self._points = dict([*self._points.items()][-1:])
            model = replace(dataset.model, effects=effects)
            self._points[key] = _Point(
                dataset, effects, [nuisance for nuisance, _, _ in found],
                [sizes for _, sizes, _ in found], [remaining for *_, remaining in found],
                [each.residual(model) for each in self._responses])
        return self._points[key]

    def _of_response(self, response: MeasuredResponse, unmoved: FloatArray,
                     vector: FloatArray) -> FloatArray:
        """Return the derivatives of the error of a response by the unknowns, numerically."""
        # Its gain is free, so it does not depend on the hysteresis.
        columns = np.zeros((unmoved.size, vector.size))
        for place in (*range(self._physical), *range(self.count, vector.size)):
            moved, step = self._moved(vector, place)
            model = changed_model(self.dataset.model, moved[: self.count])
            columns[:, place] = (response.residual(
                replace(model, effects=self.effects_at(moved))) - unmoved) / step
        return columns

    def _moved(self, vector: FloatArray, place: int) -> tuple[FloatArray, float]:
        """Return unknowns with one of them moved within its bounds, and by how much."""
        step = DERIVATIVE_STEP * max(1.0, abs(vector[place]))
        moved = vector.copy()
        moved[place] += step if moved[place] + step <= self.high[place] else -step
        return moved, float(moved[place] - vector[place])

    def _stretch(self) -> NDArray[np.intp]:
        """Return the number of the stretch of each fitted row and value of a response, (n,)."""
        stretches = [self.dataset.stretch[mask][fitted] for mask, fitted in zip(
            self.dataset.masks(), self._fitted, strict=True)]
        for response, fitted in zip(self._responses, self._at_frequencies, strict=True):
            last = stretches[-1][-1] if stretches else -1
            stretches.append(last + 1 + response.stretch[fitted])
        return np.concatenate(stretches)

    def _columns_at(self, vector: FloatArray, is_exact: bool = False) -> list[FloatArray]:
        """Return the derivatives of the displacement of each recording by the unknowns.

        Unless they have to be exact, rows are simulated in few parts.
        """
        exact, rough = (vector.tobytes() + bytes([flag]) for flag in (True, False))
        key, known = (exact, {exact}) if is_exact else (rough, {exact, rough})
        if self._columns[0] not in known and not self._columns_are_given:
            point, recordings = self._at(vector), range(len(self.dataset.rows))
            parts = [part if is_exact else part.in_few_parts() for part in point.dataset.simulated]
            unmoved_um = side_by_side(
                lambda index: parts[index].simulate(
                    point.effects, rows=point.dataset.rows[index]),
                recordings if vector.size > self.count else ())
            # The longest recording may take most of the time: its columns are items of their own.
            items = [(index, number) for number in (None, *range(self.count, vector.size))
                     for index in recordings]
            columns = dict(zip(items, side_by_side(
                lambda item: self._of_model(point, item[0], parts[item[0]]) if item[1] is None
                else self._of_effects(point, *item, vector, parts[item[0]], unmoved_um[item[0]]),
                items), strict=True))
            self._columns = key, [np.column_stack([
                columns[item] for item in items if item[0] == index]) for index in recordings]
        return self._columns[1]

    def _of_model(self, point: _Point, index: int, part: SimulatedRecording) -> FloatArray:
        """Return the derivatives by the changes of the model, as a part of the data shows them."""
        rows, given = point.dataset.rows[index], self.dataset.model
        there = part.there(point.effects) if isinstance(part, RecordingBefore) else point.effects
        behind = part.with_effects(there)
        pieces_um = None if self._pieces_um is None else self._pieces_um[index]
        known = self._of_pieces_um or {}
        changes = free_sensitivities(behind, rows, given, pieces_um, known.get(index))
        if self._of_pieces_um is not None:
            self._of_pieces_um.setdefault(index, changes[:, physical_count(given) :])
        decays = decay_sensitivities(part, rows, point.sizes[index], given)
        changes[:, : decays.shape[1]] += decays
        return changes

    def _of_effects(self, point: _Point, index: int, number: int, vector: FloatArray,
                    part: SimulatedRecording, unmoved_um: FloatArray) -> FloatArray:
        """Return the derivative by one parameter of the effects, numerically."""
        known = self._of_effects_um.get((index, *self._parameter_at(vector, number)))
        if known is not None:
            return known
        rows = point.dataset.rows[index]
        moved, step = self._moved(vector, number)
        effects = self.effects_at(moved)
        moved_um = part.simulate(effects, rows=rows) - unmoved_um
        nuisance = point.nuisance[index].regressors
        if nuisance.shape[1] > self._own_count[index]:
            exact = point.dataset.simulated[index]
            moved_um += (_projected_out(exact, rows, effects) - nuisance) @ point.sizes[index]
        return moved_um / step

    def _parameter_at(self, vector: FloatArray, number: int) -> tuple[Effect, int]:
        """Return the effect that an unknown belongs to, and which of its parameters it is."""
        place = int(np.searchsorted(self._ends, number, side="right")) - 1
        return self.effects_at(vector)[place], int(number - self._ends[place])

    def _moved_with_rates(self, point: _Point, index: int) -> FloatArray:
        """Return the part of the derivatives by which decay coefficients follow decay rates.

        For rows that determine the coefficients it vanishes (Golub and Pereyra 1973), but here the
        coefficients are fitted to more rows than the parameters.
        """
        part, rows, good = (point.dataset.simulated[index], point.dataset.rows[index],
                            self._good[index])
        nuisance, model = point.nuisance[index], self.dataset.model
        pairs = len(model.creep.poles_rad_per_s)
        ones = np.ones(nuisance.regressors.shape[1])
        decays = decay_sensitivities(part, rows, ones, model)[good, :pairs]
        by_size = nuisance.regressors @ (nuisance.inverse @ nuisance.inverse.T)[:, 1 : 1 + pairs]
        return by_size * (decays.T @ point.residual_um[index][good])
