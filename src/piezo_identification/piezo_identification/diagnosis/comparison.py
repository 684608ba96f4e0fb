# SPDX-License-Identifier: BSD-3-Clause
"""Where candidates compete: fitted on one part of the data, judged on another."""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from piezo_identification.conditioning.outlier_samples import outliers_of_residual
from piezo_identification.diagnosis.noise import sensor_noise_um
from piezo_identification.diagnosis.prepared_recording import PreparedRecording, retuned
from piezo_identification.diagnosis.rows import stretches, views
from piezo_models.effects import Evidence, Extent, fitted_values, with_fitted_values
from piezo_models.effects.outliers import Outliers

TUNING_PRICE = 0.02
"""Of the energy of what is not explained, beyond the noise: what a change of a parameter by the
width to which it is known costs. However large the error, tuning explains it only with changes that
can be believed."""
LEAST_STRUCTURE = 0.05
"""Part of the noise's energy that is priced at least."""

MODEL_TOLERANCE = 1e-4
"""Part of the travel to which a good model is right: less is not worth an effect."""

MOST_EVALUATIONS = 15
QUICK_EVALUATIONS = 6
"""Of a fit whose result will be fitted once more."""

STARTS, RIVAL_START = 3, 1.5
"""Guesses that a fit begins from, and what others may leave over what the first leaves."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Effects as fitted, and what is left beside them.

    Attributes
    ----------
    effects : tuple of piezo_models.effects.effect.Effect
    residual : (n,) array
        What the free and the tuning columns leave of `difference`.
    difference : (n,) array
        Measured minus simulated of all rows, each over the tolerance of its recording.
    coefficients : (m,) array
        Of the free and the tuning columns.
    covariance : (p, p) array or None
        Of the fitted values of the effects.
    """

    effects: tuple
    residual: np.ndarray
    difference: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray = None

    @property
    def values(self):
        """How many numbers were fitted."""
        return sum(fitted_values(effect)[0].size for effect in self.effects
                   if type(effect) is not Outliers)


class Contest:
    """Recordings, the part that is fitted and the part that judges.

    Parameters
    ----------
    model : StageModel
    recordings : list of Recording
        With the sign of the model, and their outliers marked.
    past_v : (float, float) or (), optional
        Of the hysteresis before each recording; by default that of `starting_past_v`.

    Raises
    ------
    ValueError
        If a recording cannot be used.
    """

    def __init__(self, model, recordings, past_v=None):
        self.model = model
        self.recordings = list(recordings)
        self.prepared = [PreparedRecording(model, recording, past_v) for recording in recordings]
        self.rows, self.stretch, self.fitted = stretches(self.prepared)
        free = [
            part.free_columns(rows) for part, rows in zip(self.prepared, self.rows, strict=True)
        ]
        tuning = np.vstack([
            part.tuning_columns(rows) for part, rows in zip(self.prepared, self.rows, strict=True)
        ])
        self.free_count = sum(columns.shape[1] for columns in free)
        columns = np.zeros((tuning.shape[0], self.free_count + tuning.shape[1]))
        start = 0
        for mask, block in zip(self._of_recording(), free, strict=True):
            columns[mask, start : start + block.shape[1]] = block
            start += block.shape[1]
        columns[:, self.free_count :] = tuning
        self.columns = columns
        self.wrong = [part.outlier for part in self.prepared]
        self.extent = self._extent()
        self.review(())

    def _extent(self):
        """How far the recordings go."""
        parts = self.prepared
        return Extent(
            max(float(np.ptp(part.measured_um[part.begin :])) for part in parts),
            min(float(part.voltage_v.min()) for part in parts),
            max(float(part.voltage_v.max()) for part in parts),
            max(part.time_s.size * part.sample_period_s for part in parts),
            min(part.sample_period_s for part in parts),
        )

    def _of_recording(self):
        """Mask of the rows of each recording."""
        edges = np.cumsum([0, *(rows.size for rows in self.rows)])
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            mask = np.zeros(edges[-1], dtype=bool)
            mask[start:end] = True
            yield mask

    def residual_um(self, index, effects=()):
        """Measured minus simulated of one recording, without what it does not tell, (N,)."""
        return self._without_free(index, self.prepared[index], effects)

    def residual_of_um(self, index, model):
        """The same beside another model."""
        past_v = self.prepared[index].past_v
        return self._without_free(index, PreparedRecording(model, self.recordings[index], past_v))

    def _without_free(self, index, part, effects=()):
        difference = part.measured_um - part.simulate(effects)
        every = np.arange(part.begin, part.time_s.size)
        step = max(1, every.size // 50_000)
        used = every[::step][~self.wrong[index][every[::step]]]
        free = np.linalg.lstsq(part.free_columns(used), difference[used], rcond=1e-12)[0]
        return difference - part.free_columns(np.arange(difference.size)) @ free

    def review(self, effects):
        """Estimate noise and outliers once more, beside the effects found."""
        residuals = [
            self.residual_um(index, effects) for index in range(len(self.prepared))
        ]
        self.noise_um, self.wrong = [], []
        for part, residual in zip(self.prepared, residuals, strict=True):
            def standing_out(noise_um, part=part, residual=residual):
                return part.outlier | outliers_of_residual(
                    residual, part.measured_um, part.voltage_v, noise_um)

            self.noise_um.append(sensor_noise_um(
                part.measured_um[part.begin :], part.voltage_v[part.begin :],
                np.where(standing_out(0.0), 0.0, residual)[part.begin :], part.sample_period_s,
                part.repeated_period,
            ))
            self.wrong.append(standing_out(self.noise_um[-1]))
        self._weigh(effects)

    def bare(self):
        """The trial without effects, tuned at the price of what it leaves itself."""
        bare = copy(self)
        bare._weigh(())
        return bare.trial(())

    def untuned(self, effects):
        """The same contest beside some effects with the model's parameters held as they are."""
        held = copy(self)
        held.columns = self.columns.copy()
        held.columns[:, self.free_count :] = 0.0
        held._weigh(effects)
        return held

    def _weigh(self, effects):
        """Tolerance of each row, the rows that count, and the projection on the fitted ones."""
        tolerances = [
            np.hypot(noise, MODEL_TOLERANCE * np.ptp(part.measured_um))
            for part, noise in zip(self.prepared, self.noise_um, strict=True)
        ]
        self.tolerance_um = np.concatenate([
            np.full(rows.size, tolerance)
            for rows, tolerance in zip(self.rows, tolerances, strict=True)
        ])
        good = ~np.concatenate(
            [wrong[rows] for wrong, rows in zip(self.wrong, self.rows, strict=True)]
        )
        self.fit, self.judge = self.fitted & good, ~self.fitted & good
        weighted = self.columns / self.tolerance_um[:, None]
        free = weighted[self.fit, : self.free_count]
        left = self.rows_of(effects)[self.fit]
        left = left - free @ np.linalg.lstsq(free, left, rcond=1e-12)[0]
        noise = float(np.sum(self._noise_of_rows()[self.fit] ** 2))
        energy = max(left @ left - noise, LEAST_STRUCTURE * noise)
        price = np.sqrt(TUNING_PRICE * energy)
        self.prior = price * np.eye(weighted.shape[1])[self.free_count :]
        self.q, self.r = np.linalg.qr(np.vstack([weighted[self.fit], self.prior]))
        self.weighted = weighted

    def rows_of(self, effects, quick=()):
        """Measured minus simulated over the tolerance, at all rows."""
        difference = np.concatenate([
            (part.measured_um - part.simulate(effects, quick))[rows]
            for part, rows in zip(self.prepared, self.rows, strict=True)
        ])
        return difference / self.tolerance_um

    def _objective(self, difference):
        """What the free and tuning columns leave of the fitted rows, with their own deviations."""
        padded = np.concatenate(
            [difference[self.fit], np.zeros(self.columns.shape[1] - self.free_count)]
        )
        return padded - self.q @ (self.q.T @ padded)

    def trial(self, effects, covariance=None, quick=()):
        """Judge effects as they are."""
        difference = self.rows_of(effects, quick)
        padded = np.concatenate(
            [difference[self.fit], np.zeros(self.columns.shape[1] - self.free_count)]
        )
        coefficients = np.linalg.lstsq(self.r, self.q.T @ padded, rcond=1e-12)[0]
        return Trial(tuple(effects), difference - self.weighted @ coefficients, difference,
                     coefficients, covariance)

    def fit_effects(self, effects, fixed=(), quick=False):
        """Fit effects by nonlinear least squares.

        Parameters
        ----------
        effects : sequence of piezo_models.effects.effect.Effect
            To begin from.
        fixed : sequence of piezo_models.effects.effect.Effect
            Kept as they are, before the others.
        quick : bool
            See `PreparedRecording.simulate`.

        Returns
        -------
        Trial
        """
        starts = [fitted_values(effect, self.extent) for effect in effects]
        sizes = np.cumsum([0, *(values.size for values, _, _ in starts)])

        def effects_at(vector):
            return tuple(
                with_fitted_values(effect, vector[start:end])
                for effect, start, end in zip(effects, sizes[:-1], sizes[1:], strict=True)
            )

        def difference(vector):
            tried = effects_at(vector)
            return self._objective(self.rows_of((*fixed, *tried), tried if quick else ()))

        vector, low, high = (np.concatenate(parts) for parts in zip(*starts, strict=True))
        solution = least_squares(
            difference, np.clip(vector, low, high), bounds=(low, high), x_scale="jac", ftol=1e-5,
            max_nfev=QUICK_EVALUATIONS if quick else MOST_EVALUATIONS,
        )
        scatter = 2.0 * solution.cost / max(1, np.count_nonzero(self.fit) - vector.size)
        covariance = scatter * np.linalg.pinv(solution.jac.T @ solution.jac)
        found = effects_at(solution.x)
        return self.trial((*fixed, *found), covariance, found if quick else ())

    def evidence(self, index, effects=()):
        """What a recording shows beside the model with these effects."""
        part = self.prepared[index]
        mask = next(mask for number, mask in enumerate(self._of_recording()) if number == index)
        fit = self.fit[mask]
        rows, tolerance_um = self.rows[index][fit], self.tolerance_um[mask][0]
        simulated_um = part.simulate(effects)
        return Evidence(
            part.sample_period_s, part.voltage_v, simulated_um, self.residual_um(index, effects),
            self.noise_um[index], self.model.dynamics, part.drive_um,
            *views(self.weighted[mask][fit], self.prior, rows, tolerance_um,
                   part.measured_um - simulated_um),
        )

    def evidences(self, effects=()):
        """What each recording shows beside the model with these effects."""
        return [self.evidence(index, effects) for index in range(len(self.prepared))]

    def challenge(self, kind, effects, evidences):
        """The best fit of one more effect beside those found.

        Parameters
        ----------
        kind : type
            Of the effect.
        effects : tuple of piezo_models.effects.effect.Effect
            Those found.
        evidences : list of Evidence
            One for each recording, beside those found.

        Returns
        -------
        Trial or None
            As guessed if no guess is better than nothing; None without any guess.
        """
        starts = [self._within_bounds(start)
                  for evidence in evidences for start in kind.starts(evidence)]
        if not starts:
            return None
        costs = []
        for start in starts:
            left = self._objective(self.rows_of((*effects, start), (start,)))
            costs.append(left @ left)
        none = self._objective(self.rows_of(effects))
        promising = [
            starts[number] for number in np.argsort(costs)
            if costs[number] < none @ none and costs[number] < RIVAL_START * min(costs)
        ][:STARTS]
        if not promising:
            start = starts[np.argmin(costs)]
            return self.trial((*effects, start), quick=(start,))
        fits = [self.fit_effects((start,), effects, quick=True) for start in promising]
        return min(fits, key=lambda fit: np.sum(fit.residual[self.fit] ** 2))

    def _within_bounds(self, effect):
        """The effect with parameters that are physically possible, each by itself."""
        return with_fitted_values(effect, fitted_values(effect, self.extent)[0])

    def impossible(self, trial):
        """Why no stage can have the effects of a trial, by their names; empty if one can.

        Returns
        -------
        dict of str to str
        """
        reasons = {effect.name: effect.impossible(self.extent) for effect in trial.effects}
        return {name: reason for name, reason in reasons.items() if reason}

    def held_out_square(self, trial):
        """Mean square of what is left on the rows that judge, in tolerances."""
        return float(np.mean(trial.residual[self.judge] ** 2))

    def structure(self, trial):
        """Mean square of what is left beyond the noise on the rows that judge, in tolerances."""
        expected = float(np.mean(self._noise_of_rows()[self.judge] ** 2))
        return max(0.0, self.held_out_square(trial) - expected)

    def _noise_of_rows(self):
        """The sensor's noise at all rows, in tolerances."""
        noise_um = np.concatenate([
            np.full(rows.size, noise_um)
            for rows, noise_um in zip(self.rows, self.noise_um, strict=True)
        ])
        return noise_um / self.tolerance_um

    def significance(self, before, after):
        """How surely the second trial is better than the first on the rows that judge.

        The prediction by which they differ is correlated with what the first left. The products
        are summed up within each stretch, so that errors that are alike for long count as one.

        Returns
        -------
        float
            In standard deviations.
        """
        judge = self.judge
        change = before.residual[judge] - after.residual[judge]
        stretch = self.stretch[judge]
        signal = np.bincount(stretch, before.residual[judge] * change)
        chance = np.bincount(stretch, after.residual[judge] * change)
        # Even a perfect fit leaves the noise.
        least = np.mean(after.residual[judge] ** 2) * np.sum(change**2)
        spread = np.sqrt(max(np.sum(chance**2), least))
        return float(np.sum(signal) / spread) if spread > 0.0 else 0.0

    def visible(self, before, after):
        """Part of what effects contribute that the free and tuning columns cannot explain.

        Parameters
        ----------
        before, after : Trial
            Without and with the effects.
        """
        contribution = before.difference - after.difference
        contribution = contribution - contribution[self.fit].mean()
        whole = np.linalg.norm(contribution[self.fit])
        return float(np.linalg.norm(self._objective(contribution)) / max(whole, 1e-300))

    def contribution(self, before, after):
        """RMS of what effects contribute on the rows that judge, means removed, in tolerances."""
        squares, count = 0.0, 0
        for mask in self._of_recording():
            added = (before.difference - after.difference)[mask & self.judge]
            squares, count = squares + np.sum((added - added.mean()) ** 2), count + added.size
        return float(np.sqrt(squares / count))

    def size(self, before, after):
        """RMS of the prediction by which two trials differ, in tolerances."""
        judge = self.judge
        return float(np.sqrt(np.mean((before.residual[judge] - after.residual[judge]) ** 2)))

    def extended_model(self, trial):
        """The model with the effects, and its parameters as they were tuned beside them."""
        changes = trial.coefficients[self.free_count :]
        model = retuned(self.model, changes)
        return replace(model, effects=(*self.model.effects, *trial.effects))
