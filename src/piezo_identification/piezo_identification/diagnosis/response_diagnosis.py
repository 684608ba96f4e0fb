# SPDX-License-Identifier: BSD-3-Clause
"""What a model lacks to explain a measured frequency response: a contest of linear effects."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from piezo_common.cancellation import check_cancelled
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.estimators.estimate import (
    dynamics_of_vector,
    dynamics_vector,
    parameter_deviations,
)
from piezo_identification.estimators.frequency_response.response_hold import without_hold
from piezo_models.effects import Extent, fitted_values, with_fitted_values
from piezo_models.effects.creep import Creep
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode

BLOCK, HELD_OUT = 5, 3
"""Neighbouring frequencies that stay together, and which of these blocks are held out: one in 3."""

TOLERANCE = 0.01
"""Part of the gain to which a good model is right: less is not worth an effect."""

TUNING = np.log(1.02)
"""To which the parameters of the model's dynamics are known, as a logarithm."""

SIGNIFICANT = 3.0
"""Standard deviations that a gain on held-out blocks must have."""

WORTHWHILE_PERCENT = 10.0
"""Reduction of the error on held-out frequencies below which no effect is named."""

TWIN_PERCENT = 5.0
"""Difference of two errors below which the response does not tell the candidates apart."""

EXPLAINED = 0.1
"""Part of the square of the error beyond the tolerance that may be left where it is explained."""

SLOWEST = 10
"""One in so many frequencies tells the sign of the sensor: the slowest, which nothing delays."""

MOST_EFFECTS = 4
MODE_STARTS, CREEP_RELAXATIONS = 24, 3
MOST_EVALUATIONS = 20


@dataclass(frozen=True, eq=False)
class ResponseDiagnosis(Verdict):
    """A verdict on a frequency response, with its evidence; the effects in the order found.

    Errors are those of the gain: `rms_um` and noise per V, `e_y_percent` the relative norm.

    Attributes
    ----------
    tried : list of list of (str, float)
        Each round's candidates, and by how many percent they changed the error held out.
    measured : FrequencyResponse
    before_gain, after_gain : ndarray of complex
        Of the model and of the extended one at the measured frequencies.
    """

    tried: list
    measured: object
    before_gain: np.ndarray
    after_gain: np.ndarray


def diagnose_response(model, measured):
    """Find which linear effect a model lacks to explain a frequency response.

    Creep, a further mode of vibration, a delay and a lag of the sensor compete. Each is fitted on
    two thirds of the frequencies beside the gain, which the hysteresis leaves open, and the model's
    dynamics within `TUNING`; it is judged on the rest. Effects that are not linear do not show in a
    response.

    Parameters
    ----------
    model : StageModel
    measured : FrequencyResponse
        A hold in it is taken out.

    Returns
    -------
    ResponseDiagnosis

    Raises
    ------
    ValueError
        If there are too few frequencies.
    """
    if measured.frequency_hz.size < 4 * BLOCK * HELD_OUT:
        raise ValueError(
            f"{measured.path} has {measured.frequency_hz.size} frequencies, too few to hold some "
            f"out: measure at least {4 * BLOCK * HELD_OUT}"
        )
    measured = without_hold(measured, model.linear())
    is_reversed = _moves_against(model, measured)
    if is_reversed:
        measured = replace(measured, gain=-measured.gain)
    contest = _Contest(model, measured)
    start = current = contest.tuned(())
    effects, tried, not_decidable = [], [], {}
    allowed = max(1.0, EXPLAINED * contest.structure(start))
    while len(effects) < MOST_EFFECTS and contest.structure(current) > allowed:
        attempts = contest.attempts(current)
        tried.append([(trial.effects[-1].name, contest.reduction_percent(current, trial))
                      for trial in attempts])
        if not attempts or not contest.convincing(current, attempts[0]):
            break
        best = attempts[0]
        for other in attempts[1:]:
            if contest.reduction_percent(best, other) > -TWIN_PERCENT:
                not_decidable[other.effects[-1].name] = (
                    f"the response does not tell it from {best.effects[-1].name}")
        effects.append({
            "name": best.effects[-1].name,
            "error_reduction_percent": contest.reduction_percent(current, best)})
        current = best
    for entry, effect in zip(effects, current.effects, strict=True):
        entry["parameters"] = effect.parameters()
        not_decidable.pop(entry["name"], None)
    verdict = "explained" if effects else "none"
    if contest.structure(current) > allowed:
        verdict = "unexplained"
    given = contest.given()
    return ResponseDiagnosis(
        verdict, effects, contest.extended(current) if effects else model,
        contest.errors(given), contest.errors(current if effects else given), contest.noise,
        {"source": "frequencies that were not fitted", "samples": int(np.sum(~contest.fit))},
        not_decidable, contest.description(current) if verdict == "unexplained" else "",
        [str(measured.path)] if is_reversed else [], [],
        tried, measured, contest.gain(given), contest.gain(current if effects else given),
    )


def _moves_against(model, measured):
    """Whether the sensor counts against the model where the stage is slow."""
    slow = np.argsort(measured.frequency_hz)[: max(1, measured.frequency_hz.size // SLOWEST)]
    gain = measured.gain[slow]
    response = full_response(model, measured.frequency_hz[slow])
    weight = np.abs(gain) * np.abs(response)
    return bool(np.sum((gain * response.conj()).real / np.maximum(weight, 1e-300)) < 0.0)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Logarithms by which the dynamics are changed, effects, and what is left over tolerance."""

    tuning: np.ndarray
    effects: tuple
    residual: np.ndarray


class _Contest:
    """A response, the frequencies that are fitted, and those that judge."""

    def __init__(self, model, measured):
        self.model, self.measured = model, measured
        low_hz, high_hz = measured.frequency_hz.min(), measured.frequency_hz.max()
        self.extent = Extent(np.inf, -np.inf, np.inf, 1.0 / low_hz, 0.5 / high_hz)
        self.dynamics = dynamics_vector(model.dynamics)
        self.free = self.dynamics > 0.0
        block = np.arange(measured.frequency_hz.size) // BLOCK
        self.block = block
        self.fit = block % HELD_OUT != HELD_OUT // 2
        # What neighbours on both sides do not share.
        bends = np.abs(np.diff(measured.gain, 2))
        self.noise = float(np.median(bends) / np.sqrt(6.0 * np.log(2.0)))
        self.tolerance = np.hypot(self.noise, TOLERANCE * np.abs(measured.gain))

    def _model(self, tuning, effects):
        vector = self.dynamics.copy()
        vector[self.free] *= np.exp(tuning)
        dynamics = dynamics_of_vector(
            vector, len(self.model.dynamics.damping_ratios),
            len(self.model.dynamics.antiresonance_damping_ratios))
        return replace(
            self.model, dynamics=dynamics, effects=(*self.model.effects, *effects))

    def _residual(self, tuning, effects):
        """What the gain that fits best leaves, over tolerance, (N,)."""
        check_cancelled()
        response = full_response(self._model(tuning, effects), self.measured.frequency_hz)
        response, wanted = response / self.tolerance, self.measured.gain / self.tolerance
        fitted = response[self.fit]
        gain = np.vdot(fitted, wanted[self.fit]).real / np.vdot(fitted, fitted).real
        return wanted - gain * response

    def _solve(self, tuning, effects, tunes):
        """Fit of the last effect, and of the dynamics if `tunes`."""
        last = effects[-1:]
        values, low, high = fitted_values(last[0], self.extent) if last else (np.empty(0),) * 3
        count = tuning.size if tunes else 0

        def at(vector):
            tuned = vector[:count] if tunes else tuning
            found = (with_fitted_values(last[0], vector[count:]),) if last else ()
            return tuned, (*effects[:-1], *found)

        def errors(vector):
            left = self._residual(*at(vector))[self.fit]
            return np.concatenate([left.real, left.imag])

        start = np.concatenate([tuning[:count], values])
        if start.size == 0:
            return self._trial(tuning, effects)
        low = np.concatenate([np.full(count, -TUNING), low])
        high = np.concatenate([np.full(count, TUNING), high])
        free = np.ones(start.size, dtype=bool)
        while True:
            vector, told = _fit(errors, start, low, high, free)
            if told.all() or not told.any():
                return self._trial(*at(vector))
            free[free] = told

    def _trial(self, tuning, effects):
        return _Trial(tuning, tuple(effects), self._residual(tuning, effects))

    def given(self):
        """The model as it is, but for the gain."""
        return self._trial(np.zeros(np.count_nonzero(self.free)), ())

    def tuned(self, effects):
        """The model with its dynamics tuned."""
        return self._solve(self.given().tuning, effects, tunes=True)

    def attempts(self, current):
        """Every candidate's best fit beside those found, the best on held-out frequencies first."""
        found = {type(effect) for effect in current.effects}
        trials = []
        for kind, starts in self._starts().items():
            if kind in found and not kind.several:
                continue
            fits = [self._solve(current.tuning, (*current.effects, start), tunes=False)
                    for start in starts]
            best = min(fits, key=lambda fit: self.square(fit, self.fit))
            trials.append(self._solve(best.tuning, best.effects, tunes=True))
        return sorted(trials, key=self.square)

    def _starts(self):
        """Effects to begin from, by their kind."""
        low_hz, high_hz = self.measured.frequency_hz[[0, -1]]
        middle_hz = np.sqrt(low_hz * high_hz)
        slow_s = 1.0 / (2.0 * np.pi * np.geomspace(middle_hz, 0.3 * low_hz, CREEP_RELAXATIONS))
        return {
            Creep: [Creep((0.05,) * CREEP_RELAXATIONS, tuple(slow_s))],
            VibrationMode: [
                VibrationMode(2.0 * np.pi * frequency_hz, damping, 0.1)
                for frequency_hz in np.geomspace(low_hz, high_hz, MODE_STARTS)
                for damping in (0.02, 0.2)],
            Delay: [Delay(delay_s) for delay_s in np.geomspace(0.01, 1.0, 4) / high_hz],
            SensorLag: [SensorLag(lag_s) for lag_s in np.geomspace(0.01, 1.0, 4) / high_hz],
        }

    def square(self, trial, part=None):
        """Mean square of what is left, over tolerance, where it is judged."""
        return float(np.mean(np.abs(trial.residual[~self.fit if part is None else part]) ** 2))

    def structure(self, trial):
        """Mean square of what is left beyond the tolerance."""
        return max(0.0, self.square(trial) - 2.0)

    def reduction_percent(self, before, after):
        """Of the error on held-out frequencies."""
        return float(100.0 * (1.0 - np.sqrt(self.square(after) / self.square(before))))

    def convincing(self, before, after):
        """Whether the second trial is better, in most of the held-out blocks alike."""
        if self.reduction_percent(before, after) < WORTHWHILE_PERCENT:
            return False
        judge, change = ~self.fit, before.residual - after.residual

        def blocks(residual):
            return np.bincount(self.block[judge], (residual * change.conj()).real[judge])

        spread = np.sqrt(np.sum(blocks(after.residual) ** 2))
        return bool(np.sum(blocks(before.residual)) > SIGNIFICANT * spread)

    def gain(self, trial):
        """Of a trial's model at the measured frequencies."""
        return self.measured.gain - trial.residual * self.tolerance

    def extended(self, trial):
        """The model with the effects, and its dynamics as they were tuned."""
        return self._model(trial.tuning, trial.effects)

    def errors(self, trial):
        """Of the gain on held-out frequencies."""
        judge = ~self.fit
        error = np.linalg.norm((trial.residual * self.tolerance)[judge])
        return {
            "rms_um": float(error / np.sqrt(np.count_nonzero(judge))),
            "e_y_percent": float(100.0 * error / np.linalg.norm(self.measured.gain[judge])),
        }

    def description(self, trial):
        """At which frequencies how much is left."""
        left = np.abs(trial.residual) ** 2
        power = np.cumsum(left) / np.sum(left)
        frequency_hz = self.measured.frequency_hz
        low_hz, high_hz = frequency_hz[np.searchsorted(power, [0.1, 0.9])]
        worst = int(np.argmax(left))
        return (
            f"Left is {np.sqrt(np.mean(left)):.3g} times the tolerance of {100 * TOLERANCE:g} % "
            f"and the noise, most of it from {low_hz:.3g} to {high_hz:.3g} Hz, largest at "
            f"{frequency_hz[worst]:.4g} Hz."
        )


def _fit(errors, start, low, high, free):
    """Fit some of the parameters; return all of them, and which of the fitted ones the data tell.

    What the data do not tell within its bounds would go anywhere: it is to stay where it starts.

    Parameters
    ----------
    errors : callable
        Of a vector, over their standard deviation.
    start, low, high : (n,) array
    free : (n,) array of bool

    Returns
    -------
    vector : (n,) array
    told : (m,) array of bool
        Of the free ones.
    """
    def whole(part):
        vector = start.copy()
        vector[free] = part
        return vector

    low, high = low[free], high[free]
    solution = least_squares(
        lambda part: errors(whole(part)), np.clip(start[free], low + 1e-12, high - 1e-12),
        bounds=(low, high), x_scale="jac", ftol=1e-4, max_nfev=MOST_EVALUATIONS,
    )
    return whole(solution.x), parameter_deviations(solution.jac) < high - low


def full_response(model, frequency_hz):
    """Response of a model with its linear effects, those of the sensor and the delay too.

    Parameters
    ----------
    model : StageModel
    frequency_hz : ndarray

    Returns
    -------
    ndarray of complex
    """
    s = 2j * np.pi * frequency_hz
    response = model.response(frequency_hz)
    for place in ("displacement", "sensor"):
        for effect in model.effects_at(place):
            response = response * effect.response(s)
    return response
