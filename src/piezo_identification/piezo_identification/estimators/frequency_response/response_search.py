# SPDX-License-Identifier: BSD-3-Clause
"""Fits of rational forms to a measured response, and the search for the one with most evidence."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import finest_power, independent_rows, without_span
from piezo_identification.estimators.frequency_response.rational_form import (
    DELAY,
    LAG,
    LOSS,
    RationalForm,
    Reduced,
)
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.estimators.poles.vector_fitting import (
    LINES,
    Lines,
    residual_of_poles,
    vector_fit,
)
from piezo_identification.fitting.evidence import INDEPENDENT, log_evidence
from piezo_identification.fitting.measured_response import MOST_LOSS_RAD, MeasuredResponse

SPARE_POLES = 40
"""Number of poles of the fit that determines noise and delay: more than a stage has."""

DELAYS_A_TURN, MOST_DELAYS = 4, 48
"""Number of delays tried per turn of phase at the highest strong frequency, and in total."""

LOSS_STEP_RAD = 1e-3
"""Accuracy of the angle by which hysteresis delays small sines in this fit."""

STRONG = 0.02
"""Gain, relative to the largest, above which a frequency is strong."""

CREEP_STARTS = 16
"""Number of initial rates of a further creep pair."""

START_DAMPINGS = (0.002, 0.02, 0.2, 1.0)
"""Initial damping ratios of a further mode."""

PATIENCE = 3
"""Number of successive components without a gain of evidence after which the search ends."""

MOST_CREEP_PAIRS = 3
"""Largest number of creep pairs that is tried."""

RANKED = 5
"""Number of smaller models, the most promising by a linear step, that are fitted."""

START_LAGS = (0.2, 1.0, 5.0)
"""Initial lags, relative to the inverse of the highest measured rate."""

STEPS, QUICK_STEPS, LAST_STEPS = 40, 10, 300
"""Largest numbers of steps of a fit, of a quick fit that compares starts, and of the final fit."""

ROUNDING, LAST_ROUNDING = 1e-6, 1e-12
"""Relative change of the sum of squares at which a fit, and the final fit, end."""


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A fitted form."""

    form: RationalForm

    vector: FloatArray
    """Shape (P,)."""
    free: BoolArray
    """Parameters that were fitted, (P,); the others are zero."""
    cost: float
    """Sum of squares of the weighted error."""
    frequencies: int
    """Number of frequencies used."""

    @property
    def parameters(self) -> int:
        """Number of fitted parameters."""
        return int(np.sum(self.free))


class ResponseSearch:
    """A measured response, its noise, and fits of forms to it.

    Parameters
    ----------
    measured : FrequencyResponse
        Response without a hold.
    has_loss : bool
        Whether the stage has hysteresis, by which small sines of any frequency may lag.

    Attributes
    ----------
    weight : ndarray, shape (N,)
        Inverse standard deviation of each gain, scaled so that the weighted error has the same mean
        square.
    independent : float
        Number of independent errors, counting real and imaginary parts.
    noise : float
        Standard deviation of each part of the weighted gain, as a fit of many poles leaves it.
    """

    def __init__(self, measured: FrequencyResponse, has_loss: bool = False) -> None:
        self._has_loss = has_loss
        self.rate, self.gain = 2.0 * np.pi * measured.frequency_hz, measured.gain
        step = -(-self.rate.size // LINES)
        self._coarse = slice((self.rate.size - 1) % step, None, step)
        self.weight = np.ones(self.rate.size)
        self._delay_s, self._loss_rad, poles = self._delay_loss_and_poles()
        residual = self._residual(poles)
        self.weight = weight_of_noise(residual, self.gain - residual)
        residual = self.weight * self._residual(poles)
        self.independent = independent_rows(np.concatenate([residual.real, residual.imag]))
        spare = max(2 * self.rate.size - 2 * poles.size - 1, 1)
        self.noise = float(np.linalg.norm(residual) / np.sqrt(spare))
        self._rounding = finest_power(np.abs(self.gain))

    def _residual(self, poles: ComplexArray) -> ComplexArray:
        turned = self.gain * np.exp(1j * (self.rate * self._delay_s + self._loss_rad))
        return residual_of_poles(Lines(self.rate, turned, weight=self.weight), poles)

    def _delay_loss_and_poles(self) -> tuple[float, float, ComplexArray]:
        """Delay and loss with which a fit of many poles is best, and these poles."""
        rate, gain = self.rate[self._coarse], self.gain[self._coarse]
        strong = rate[np.abs(gain) > STRONG * np.abs(gain).max()]
        turn_s = 2.0 * np.pi / strong[-1]
        # Twice the mean slope of the phase exceeds the delay.
        turning = np.angle(gain[1:] * gain[:-1].conj()) / np.diff(rate)
        slope_s = max(0.0, -float(np.median(turning[-turning.size // 3 :])))
        longest_s = turn_s + 2.0 * slope_s
        count = min(round(DELAYS_A_TURN * longest_s / turn_s), MOST_DELAYS)

        def fitted(delay_s: float,
                   loss_rad: float = 0.0) -> tuple[float, float, float, ComplexArray]:
            check_cancelled()
            turned = Lines(rate, gain * np.exp(1j * (rate * delay_s + loss_rad)))
            poles = vector_fit(turned, min(SPARE_POLES, rate.size // 5))
            residual = float(np.linalg.norm(residual_of_poles(turned, poles)))
            return residual, delay_s, loss_rad, poles

        best = min(map(fitted, np.linspace(0.0, longest_s, count + 1)), key=lambda fit: fit[0])
        if self._has_loss:
            # Poles do not describe the same angle at all frequencies.
            loss_rad = minimize_scalar(
                lambda each: fitted(best[1], each)[0], bounds=(0.0, MOST_LOSS_RAD),
                options={"xatol": LOSS_STEP_RAD}).x
            best = min(best, fitted(best[1], loss_rad), key=lambda fit: fit[0])
        return best[1:]

    def measured_response(self) -> MeasuredResponse:
        """Return the response with its noise for a fit together with recordings."""
        return MeasuredResponse(
            self.rate / (2.0 * np.pi), self.weight * self.gain, self.weight, self.noise,
            min(self.independent, INDEPENDENT))

    def information(self, fit: ResponseFit) -> float:
        """Bayesian information criterion; the smallest is best."""
        mean_square = fit.cost / (2.0 * fit.frequencies) + self._rounding
        return -2.0 * log_evidence(mean_square, fit.parameters, self.independent)

    def residual(
        self, form: RationalForm, vector: FloatArray, rows: slice = slice(None),
    ) -> tuple[FloatArray, FloatArray]:
        """Weighted error, shape (2 N,), and its derivatives, shape (2 N, P)."""
        response, slopes = form.response(vector, self.rate[rows])
        weight = self.weight[rows]
        error, slopes = weight * (response - self.gain[rows]), weight[:, None] * slopes
        return np.concatenate([error.real, error.imag]), np.vstack([slopes.real, slopes.imag])

    def quick_fit(self, start: Reduced, steps: int = QUICK_STEPS) -> ResponseFit:
        """Fit to the coarse frequencies in a few steps."""
        return self.fit(start, steps, rows=self._coarse)

    def full_fit(self, fit: ResponseFit) -> ResponseFit:
        """Continue a fit, first with the coarse frequencies, then with all."""
        if self._coarse.step > 1:
            fit = self.quick_fit((fit.form, fit.vector, fit.free), STEPS)
        return self.fit((fit.form, fit.vector, fit.free))

    def fit(
        self, start: Reduced, steps: int = STEPS, rounding: float = ROUNDING,
        rows: slice = slice(None),
    ) -> ResponseFit:
        """Least squares by damped steps within the bounds (Levenberg and Marquardt)."""
        form, vector, free = start
        low, high = form.bounds(self.rate)
        vector = np.where(free, np.clip(vector, low, high), vector)
        error, slopes = self.residual(form, vector, rows)
        cost, damping, calm = float(error @ error), 1e-3, 0
        for _ in range(steps):
            check_cancelled()
            slope = slopes.T @ error
            held = ~free | ((vector <= low) & (slope > 0.0)) | ((vector >= high) & (slope < 0.0))
            moved = np.flatnonzero(~held)
            square = slopes[:, moved].T @ slopes[:, moved]
            scale = np.sqrt(np.maximum(np.diag(square), np.finfo(float).tiny))
            square = square / np.outer(scale, scale)
            while damping < 1e8:
                step = np.linalg.solve(
                    square + damping * np.eye(moved.size), slope[moved] / scale) / scale
                tried = vector.copy()
                tried[moved] = np.clip(vector[moved] - step, low[moved], high[moved])
                error, slopes_there = self.residual(form, tried, rows)
                if error @ error < cost:
                    break
                damping *= 6.0
            else:
                break
            gain, cost = cost - float(error @ error), float(error @ error)
            vector, slopes, damping = tried, slopes_there, max(damping / 5.0, 1e-12)
            calm = calm + 1 if gain < rounding * cost else 0
            if calm == 2:
                break
        return ResponseFit(form, vector, free, cost, error.size // 2)

    def grown(self, wanted: ResponseOrder, most_states: int) -> Iterator[ResponseFit]:
        """Yield fits of parallel modes, one component more each time, with all else free."""
        best_information, without_gain = np.inf, 0
        fit = self.full_fit(self._fitted_poles(0, wanted.creep_pairs or 0))
        while True:
            yield fit
            information = self.information(fit)
            without_gain = 0 if information < best_information else without_gain + 1
            best_information = min(information, best_information)
            enough = without_gain >= PATIENCE if wanted.modes is None else (
                fit.form.modes >= wanted.modes + PATIENCE)
            if enough or 2 * fit.form.modes + fit.form.creep_pairs + 3 > most_states:
                return
            starts = list(self._further_modes(fit))
            if wanted.creep_pairs is None and fit.form.creep_pairs < MOST_CREEP_PAIRS:
                starts.append(self._further_pair(fit))
            fits = [self.quick_fit(start) for start in starts]
            fits.append(self._fitted_poles(
                fit.form.modes + 1, fit.form.creep_pairs, fit.vector[DELAY] / self.rate[-1]))
            fit = self.full_fit(min(fits, key=self.information))

    def with_another_lag(self, fit: ResponseFit) -> ResponseFit:
        """Fit parallel modes again from other lags, with the delay changed accordingly."""
        form, tried = fit.form, [fit]
        for lag in START_LAGS:
            vector = fit.vector.copy()
            vector[[DELAY, LAG]] = max(0.0, vector[DELAY] + min(vector[LAG], 1.0) - lag), lag
            error, slopes = self.residual(form, vector)
            linear = form.linear_places[fit.free[form.linear_places]]
            vector[linear] -= np.linalg.lstsq(slopes[:, linear], error, rcond=None)[0]
            tried.append(self.full_fit(self.quick_fit((form, vector, fit.free))))
        return min(tried, key=lambda each: each.cost)

    def with_real_parts(self, fit: ResponseFit) -> ResponseFit:
        """Fit the same modes as those of a structure, without velocity or instantaneous parts."""
        form, vector, free = fit.form, fit.vector.copy(), fit.free.copy()
        places = np.append(form.gain_place, form.mode_places[3])
        vector[places], free[places] = 0.0, False
        return self.with_another_lag(self.full_fit(self.quick_fit((form, vector, free))))

    def _unexplained(self, fit: ResponseFit) -> tuple[FloatArray, FloatArray]:
        """Return the residual at the coarse frequencies, and a basis of what a fit can change."""
        error, slopes = self.residual(fit.form, fit.vector, self._coarse)
        basis = np.linalg.qr(slopes[:, fit.free])[0]
        return without_span(error, basis), basis

    def _further_pair(self, fit: ResponseFit) -> Reduced:
        """Return the form with the creep pair that explains most of the residual."""
        error, basis = self._unexplained(fit)
        rate = self.rate[self._coarse]
        poles = np.geomspace(0.3 * rate[0], np.sqrt(rate[0] * rate[-1]), CREEP_STARTS)
        whole = self.weight[self._coarse] * fit.form.response(fit.vector, rate)[0]
        pair = poles / (1j * rate[:, None] + poles) * whole[:, None]
        columns = without_span(np.vstack([pair.real, pair.imag]), basis)
        power = np.maximum(np.sum(columns**2, axis=0), np.finfo(float).tiny)
        along = -error @ columns
        best = int(np.argmax(along**2 / power))
        pole = float(np.log(poles[best]))
        return fit.form.with_creep(
            fit.vector, fit.free, pole, pole + float(np.clip(along[best] / power[best], -0.5, 0.5)))

    def _further_modes(self, fit: ResponseFit) -> Iterator[Reduced]:
        """Yield the two modes that explain most of the residual, with all else free."""
        error, basis = self._unexplained(fit)
        rate = self.rate[self._coarse]
        before = RationalForm(fit.form.creep_pairs, 0)
        head, _ = before.response(np.append(fit.vector[: before.gain_place], 1.0), rate)
        frequency, damping = (each.ravel() for each in np.meshgrid(rate, START_DAMPINGS))
        ratio = 1j * rate[:, None] / frequency
        position = (self.weight[self._coarse] * head)[:, None] / (
            ratio**2 + 2.0 * damping * ratio + 1.0)
        columns = [without_span(np.vstack([part.real, part.imag]), basis)
                   for part in (position, position * ratio)]
        pp, pv, vv = (np.sum(columns[i] * columns[j], axis=0)
                      for i, j in ((0, 0), (0, 1), (1, 1)))
        p, v = (-error @ column for column in columns)
        determinant = np.maximum(pp * vv - pv**2, 1e-12 * pp * vv)
        parts = np.array([vv * p - pv * v, pp * v - pv * p]) / determinant
        explained = parts[0] * p + parts[1] * v
        first = int(np.argmax(explained))
        apart = np.abs(np.log(frequency / frequency[first])) > 0.05
        for place in (first, int(np.argmax(np.where(apart, explained, -np.inf)))):
            yield fit.form.with_mode(fit.vector, fit.free, np.array([
                np.log(frequency[place]), np.log(damping[place]), *parts[:, place]]))

    def _fitted_poles(
        self, modes: int, creep_pairs: int, *more_delays_s: float,
    ) -> ResponseFit:
        """Fit from the poles of a vector fit: the slowest are creep, one of the fast the lag."""
        form = RationalForm(creep_pairs, modes)
        rate, gain = self.rate[self._coarse], self.gain[self._coarse]
        weight, tried = self.weight[self._coarse], []
        for delay_s in (self._delay_s, *more_delays_s):
            check_cancelled()
            turned = Lines(rate, gain * np.exp(1j * rate * delay_s), weight=weight)
            found = vector_fit(turned, 2 * modes + creep_pairs + 1)
            residual = np.linalg.norm(weight * residual_of_poles(turned, found))
            tried.append((residual, delay_s, found))
        _, delay_s, poles = min(tried, key=lambda entry: entry[0])
        relaxations = np.sort(-poles[poles.imag == 0.0].real)
        creep, fast = np.split(relaxations, [min(creep_pairs, relaxations.size)])
        pairs = [(abs(pole), -pole.real / abs(pole)) for pole in poles[poles.imag > 0.0]]
        lag = 0.0
        if fast.size % 2:
            lag, fast = self.rate[-1] / fast[-1], fast[:-1]
        pairs += [(np.sqrt(one * other), 0.5 * (one + other) / np.sqrt(one * other))
                  for one, other in fast.reshape(-1, 2)]
        pairs = pairs[:modes]
        spare = np.full((modes - len(pairs), 2), [self.rate[-1], 1.0])
        middle = np.full(creep_pairs - creep.size, np.sqrt(self.rate[0] * self.rate[-1]))
        vector = np.zeros(form.size)
        vector[[DELAY, LAG]] = delay_s * self.rate[-1], lag
        vector[form.creep_places] = np.log(np.append(creep, middle))
        vector[form.creep_places[1]] += 0.1
        vector[form.mode_places[:2]] = np.log(np.vstack([*np.reshape(pairs, (-1, 2)), *spare])).T \
            if modes else 0.0
        low, high = form.bounds(self.rate)
        vector = np.clip(vector, low, high)
        error, slopes = self.residual(form, vector, self._coarse)
        linear = form.linear_places
        vector[linear] -= np.linalg.lstsq(slopes[:, linear], error, rcond=None)[0]
        return self.quick_fit((form, vector, self._all_free(form)))

    def _all_free(self, form: RationalForm) -> BoolArray:
        free = np.ones(form.size, dtype=bool)
        free[LOSS] = self._has_loss
        return free

    def reduced(
        self, fit: ResponseFit, wanted: ResponseOrder, least: float = np.inf,
    ) -> Iterator[ResponseFit]:
        """Yield fits with one component less each time, as long as the evidence increases.

        The search ends when no smaller model could have less information than `least`.
        """
        while self.information(fit) - fit.parameters * np.log(self.independent) < least:
            starts = [(self._promise(start), start) for start in fit.form.reduced(
                fit.vector, fit.free) if _leads_to(start[0], wanted)]
            starts.sort(key=lambda entry: entry[0])
            if not starts:
                return
            quick = [self.quick_fit(start) for _, start in starts[:RANKED]]
            smaller = self.full_fit(min(quick, key=self.information))
            if _grants(fit.form, wanted) and self.information(smaller) >= self.information(fit):
                return
            fit = smaller
            yield fit

    def _promise(self, start: Reduced) -> float:
        """Information after a single linear step."""
        form, vector, free = start
        frequencies = self.rate[self._coarse].size
        residual, _ = self._unexplained(ResponseFit(form, vector, free, np.nan, frequencies))
        return self.information(ResponseFit(
            form, vector, free, float(residual @ residual), frequencies))

    def in_series(self, fit: ResponseFit, antiresonances: int | None) -> ResponseFit:
        """Fit the same modes in series, with the zeros between them."""
        parallel = fit.form
        zeros = parallel.zeros_between(fit.vector, self.rate)
        missing = max(0, (antiresonances or 0) - zeros.shape[1])
        if missing:
            # Missing zeros start on modes, which they cancel.
            zeros = np.hstack([zeros, fit.vector[parallel.mode_places[:2, :missing]]])
        form = RationalForm(parallel.creep_pairs, parallel.modes, zeros.shape[1], is_parallel=False)
        vector = np.zeros(form.size)
        vector[: form.gain_place] = fit.vector[: form.gain_place]
        vector[form.mode_places] = fit.vector[parallel.mode_places[:2]]
        vector[form.zero_places] = zeros
        vector[form.gain_place] = 1.0
        error, slopes = self.residual(form, vector)
        shape = slopes[:, form.gain_place]
        vector[form.gain_place] -= shape @ error / (shape @ shape)
        return self.full_fit(self.quick_fit((form, vector, self._all_free(form))))


def _leads_to(form: RationalForm, wanted: ResponseOrder) -> bool:
    """Return whether a form has at least as many of each component as requested."""
    return all(number >= (asked or 0) for number, asked in (
        (form.creep_pairs, wanted.creep_pairs), (form.modes, wanted.modes),
        (form.antiresonances, 0 if form.is_parallel else wanted.antiresonances)))


def _grants(form: RationalForm, wanted: ResponseOrder) -> bool:
    return wanted.grants(ResponseOrder(
        form.creep_pairs, form.modes, form.antiresonances, is_coupled=form.is_parallel))


def weight_of_noise(residual: ComplexArray, gain: ComplexArray) -> FloatArray:
    """Return the inverse noise of each gain, which has a constant and a relative part.

    Their ratio maximises the likelihood of the residual of a rich fit. The result, (N,), is scaled
    so that the weighted error has the mean square of the unweighted one.
    """
    power, best = np.abs(gain) ** 2, (np.inf, np.ones(gain.size))
    for relative in (0.0, *np.geomspace(1e-2, 1e3, 26)):
        variance = 1.0 + relative**2 * power / power.max()
        misfit = np.sum(np.log(variance)) + gain.size * np.log(
            np.mean(np.abs(residual)**2 / variance))
        best = min(best, (misfit, variance), key=lambda entry: entry[0])
    return np.sqrt(np.mean(best[1]) / best[1])
