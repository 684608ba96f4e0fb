# SPDX-License-Identifier: BSD-3-Clause
"""Creep, electric and vibration dynamics and a delay from a measured frequency response."""

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import (
    Estimate,
    OrderTrial,
    order_trial,
    parameter_covariance,
    split_dynamics_vector,
)
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_growth import embedded, holds
from piezo_identification.estimators.frequency_response.response_hold import without_hold
from piezo_identification.estimators.frequency_response.response_model import (
    ANY_ORDER,
    ResponseModel,
    ResponseOrder,
)
from piezo_identification.estimators.frequency_response.response_standing import (
    FASTEST,
    lack_of_standing,
    without_idle,
)
from piezo_identification.estimators.frequency_response.vector_fitting import (
    residues_error,
    vector_fit,
)
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

MOST_STATES = 20
"""States beyond which the search for the order ends: a lag, three pairs of creep, eight modes."""

MOST_CREEP_PAIRS = 3
"""Pairs of creep poles and zeros up to which every number is tried."""

SEARCH_CREEP_PAIRS = 1
"""Pairs with which the modes are sought: enough that no mode is spent on creep."""

PATIENCE = 2
"""Numbers of modes in succession that may bring no gain before the search ends."""

SPARE_POLES = 32
"""Poles of the rational fit that finds the resonances, some to be wasted on noise."""

MOST_DAMPED = 0.9
"""Damping ratio up to which a pair of poles may start a mode."""

LEAST_FREQUENCIES = 24
"""Frequencies below which no order can be told from another."""

QUICK_EVALUATIONS = 12
"""Steps that tell a good start from a bad one."""

BEAM = 2
"""Orders with as many modes that are followed further: the best may not lead to the best."""

LAGGING_DAMPING, LAGGING_STARTS = 0.7, 4
"""Damping ratio, and number of frequencies over the upper decade of the band, of modes that do not
ring, to begin with: that of an amplifier of second order is none of the resonances."""

SIDE_DAMPINGS, SIDE_PARTS = (1e-3, 0.4), (-2.0, 3.0)
"""Damping ratios of a mode beside others, and parts of the displacement that it adds: those of the
effect ``vibration_mode``."""

MODE_FIELDS = ("frequency_rad_per_s", "damping_ratio", "participation")
"""A mode beside others has these numbers, in the order in which the vector holds them."""

MOST_LEFT_OUT = 8
"""Refused orders from which what they do not need is left out."""

DELAYS = 9
"""Delays from which the fit is tried, up to a period of the highest frequency that is strong."""

STRONG = 0.02
"""Part of the largest gain above which a frequency is strong."""


def estimate_from_response(
    measured: FrequencyResponse, order: ResponseOrder = ANY_ORDER, most_states: int = MOST_STATES,
) -> Estimate:
    """Fit a measured frequency response with creep, a lag, modes, antiresonances and a delay.

    Vector fitting with more poles than wanted finds the resonances; the strongest start a
    nonlinear least-squares fit of the physical parameters. A gain that rises towards low
    frequencies is creep.

    Parameters
    ----------
    measured : FrequencyResponse
        Take the part in which the sensor shows more than noise (`between`). The model is that of
        the stage alone: a hold in the response is taken out.
    order : ResponseOrder
        What it leaves open is what the Bayesian information criterion prefers, among the orders
        whose numbers have physical standing (`response_standing.lack_of_standing`).
    most_states : int
        Largest order that is tried.

    Returns
    -------
    Estimate
        Its model is a `ResponseModel`, its order a `ResponseOrder`. The standard deviations have
        the fields `gain`, `delay_s`, `creep` and `dynamics`.

    Raises
    ------
    ValueError
        If there are too few frequencies, or too few resonances for the order.
    """
    estimate = _estimate(without_hold(measured), order, most_states)
    if not measured.hold_s:
        return estimate
    # The model tells what sampling folds back.
    free = without_hold(measured, estimate.model.linear(), estimate.model.delay_s)
    again = _estimate(free, estimate.order, most_states)
    return replace(again, trials=estimate.trials, order_given=estimate.order_given)


def _estimate(
    measured: FrequencyResponse, order: ResponseOrder, most_states: int,
) -> Estimate:
    if measured.frequency_hz.size < LEAST_FREQUENCIES:
        raise ValueError(
            f"{measured.path} has {measured.frequency_hz.size} frequencies, too few: measure at "
            f"least {LEAST_FREQUENCIES}"
        )
    fit = _ResponseFit(measured)
    least_modes = max(order.modes or 0, order.antiresonances or 0)
    if least_modes > (fit.resonances.size if order.modes is None else
                      min(order.modes, fit.resonances.size)):
        raise ValueError(
            f"{measured.path} shows {fit.resonances.size} resonances, which does not allow "
            f"order {order}: ask for fewer modes or antiresonances"
        )
    fits = {
        found: entry for found, entry in fit.search(order, most_states).items()
        if order.grants(found)
    }
    standing = {found: entry for found, entry in fits.items() if not entry.trial.refusal} or fits
    chosen = min(standing, key=lambda candidate: fits[candidate].trial.information)
    best = fits[chosen]
    spread = np.sqrt(np.diag(parameter_covariance(best.jacobian, best.residual)))
    ascending = _ascending(best.vector, chosen)
    vector, spread = best.vector[ascending], spread[ascending]
    # The parts of modes beside others, at the end, are no logarithms.
    logarithms = slice(1, vector.size - chosen.beside)
    spread[logarithms] *= np.exp(vector[logarithms])
    model = fit.model(vector, chosen)
    deviations = fit.fields(spread[1:], spread[0], chosen)
    return Estimate(
        model, {name: deviations[name] for name in ("gain", "delay_s", "creep", "dynamics")},
        chosen, tuple(entry.trial for entry in fits.values()), None not in astuple(order),
        effects=model.beside, effect_deviations=tuple(deviations["beside"]),
    )


def _ascending(vector: FloatArray, order: ResponseOrder) -> FloatArray:
    """List the indices that put the components of every kind into the order of frequency."""
    (head, poles, zeros, lag, modes, dampings, antiresonances, their_dampings, side, side_dampings,
     parts) = np.split(np.arange(vector.size), np.cumsum([
         2, order.creep_pairs, order.creep_pairs, 1, order.modes, order.modes,
         *2 * [order.antiresonances], *2 * [order.beside]]))
    by_mode, by_antiresonance = np.argsort(vector[modes]), np.argsort(vector[antiresonances])
    by_side = np.argsort(vector[side])
    return np.concatenate([
        head, poles[np.argsort(vector[poles])], zeros[np.argsort(vector[zeros])], lag,
        modes[by_mode], dampings[by_mode], antiresonances[by_antiresonance],
        their_dampings[by_antiresonance], side[by_side], side_dampings[by_side], parts[by_side],
    ])


@dataclass(frozen=True)
class _Fit:
    """Parameters of one order: the delay over its longest, and logarithms of the others.

    Parts of modes beside others come last, as they are.
    """

    vector: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    trial: OrderTrial

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)


class _ResponseFit:
    """A measured response, its resonances, and the search for models of it."""

    def __init__(self, measured: FrequencyResponse) -> None:
        self.measured = measured
        self.rate = 2.0 * np.pi * measured.frequency_hz
        strength = np.abs(measured.gain)
        strong = measured.frequency_hz[strength > STRONG * strength.max()]
        self.longest_delay_s = 1.0 / strong[-1]
        self.delay_s, self.resonances = self._resonances()

    def _resonances(self) -> tuple[float, ComplexArray]:
        """Delay of the best rational fit with poles to spare, and its resonant poles."""
        count = min(SPARE_POLES, self.rate.size // 4)
        best = None
        for delay_s in np.linspace(0.0, self.longest_delay_s, DELAYS):
            gain = self.measured.gain * np.exp(1j * self.rate * delay_s)
            poles = vector_fit(self.rate, gain, count)
            error = residues_error(self.rate, gain, poles)
            if best is None or error < best[0]:
                best = (error, delay_s, poles)
        _, delay_s, poles = best
        pairs = poles[(poles.imag > self.rate[0]) & (poles.imag < self.rate[-1])]
        return delay_s, pairs[-pairs.real < MOST_DAMPED * np.abs(pairs)]

    def search(self, wanted: ResponseOrder, most_states: int) -> dict[ResponseOrder, _Fit]:
        """Fits by order: modes are added one by one, where they explain most."""
        most_modes = wanted.modes
        if most_modes is None:
            most_modes = max((most_states - 1 - SEARCH_CREEP_PAIRS) // 2,
                             wanted.antiresonances or 0)
        most_modes = min(most_modes, self.resonances.size)
        fits: dict[ResponseOrder, _Fit] = {}
        start = ResponseOrder(SEARCH_CREEP_PAIRS, 0, 0)
        best = {start: self.solve(start, self._plain_start(start))}
        self._keep(fits, best, wanted, most_states)
        least, without_gain = np.inf, 0
        for modes in range(1, most_modes + 1):
            grown: dict[ResponseOrder, _Fit] = {}
            for (order, fit), more in product(best.items(), (0, 1)):
                candidate = replace(order, modes=modes, antiresonances=order.antiresonances + more)
                if self._leads_to(wanted, candidate, most_modes):
                    entry = self._best_further_mode(order, fit.vector, candidate)
                    if candidate not in grown or entry.cost < grown[candidate].cost:
                        grown[candidate] = entry
            self._keep(fits, grown, wanted, most_states)
            promising = sorted(grown, key=lambda order: grown[order].trial.information)[:BEAM]
            best = {order: grown[order] for order in promising}
            information = min(fit.trial.information for fit in fits.values())
            without_gain = 0 if information < least else without_gain + 1
            least = information
            if wanted.modes is None and without_gain == PATIENCE:
                break
        self._begin_again_from_smaller_orders(fits)
        if wanted.modes is None and wanted.antiresonances is None:
            self._set_side_by_side(fits, most_states)
        self._leave_out_idle(fits, wanted)
        self._begin_again_from_smaller_orders(fits)
        return fits

    def _leave_out_idle(self, fits: dict[ResponseOrder, _Fit], wanted: ResponseOrder) -> None:
        """Begin smaller orders from the best refused ones, without what these do not need.

        The search follows few orders, and may not have come to these.
        """
        refused = [order for order in fits if fits[order].trial.refusal]
        best = sorted(refused, key=lambda order: fits[order].trial.information)[:MOST_LEFT_OUT]
        for order in best:
            while True:
                fit = fits[order]
                covariance = parameter_covariance(fit.jacobian, fit.residual)
                start, smaller = without_idle(fit.vector, order, covariance, self.rate[-1])
                if smaller == order or not wanted.grants(smaller):
                    break
                again = self.solve(smaller, start)
                if smaller in fits and fits[smaller].cost <= again.cost:
                    break
                fits[smaller], order = again, smaller

    def _set_side_by_side(self, fits: dict[ResponseOrder, _Fit], most_states: int) -> None:
        """Add modes beside one in series, one by one; then a second one in series to each of these.

        Modes that add up have zeros anywhere in the plane, modes that follow each other only in its
        left half. The second mode in series may be that of an amplifier, which lags and does not
        ring.
        """
        pairs = min(fits, key=lambda order: fits[order].trial.information).creep_pairs
        order = ResponseOrder(pairs, 1, 0)
        without_gain = 0
        while order in fits and without_gain < PATIENCE:
            grown = replace(order, beside=order.beside + 1)
            if grown.states > most_states or grown.beside >= self.resonances.size:
                break
            fits[grown] = self._best_mode_beside(order, fits[order], grown)
            gain = fits[order].trial.information - fits[grown].trial.information
            without_gain = 0 if gain > 0.0 else without_gain + 1
            order = grown
        for found in [found for found in fits if found.beside]:
            lagging = replace(found, modes=2)
            if lagging.states <= most_states:
                fits[lagging] = self._best_further_mode(found, fits[found].vector, lagging)

    def _best_mode_beside(self, order: ResponseOrder, fit: _Fit, grown: ResponseOrder) -> _Fit:
        """Fit with one more mode beside the others, begun at the resonance that explains most."""
        rest, parts = np.split(fit.vector, [fit.vector.size - order.beside])
        head, frequencies, dampings = np.split(rest, rest.size - order.beside * np.array([2, 1]))
        starts = []
        for pole in self.resonances:
            damping = np.clip(-pole.real / abs(pole), *SIDE_DAMPINGS)

            def start(part: float, w: float = abs(pole), zeta: float = damping) -> FloatArray:
                return np.concatenate([
                    head, frequencies, [np.log(w)], dampings, [np.log(zeta)], parts, [part]])

            slope = self._jacobian(start(0.0), grown)[:, -1]
            part = float(np.clip(-slope @ fit.residual / (slope @ slope), *SIDE_PARTS))
            left = fit.residual + part * slope
            starts.append((float(left @ left), start(part)))
        starts.sort(key=lambda entry: entry[0])
        return min((self.solve(grown, vector) for _, vector in starts[:BEAM]),
                   key=lambda entry: entry.cost)

    def _begin_again_from_smaller_orders(self, fits: dict[ResponseOrder, _Fit]) -> None:
        """Begin orders that leave more than a smaller one from that one."""
        for order in sorted(fits, key=lambda order: order.states + 2 * order.antiresonances):
            smaller = [other for other in fits if other != order and holds(order, other)]
            least = min(smaller, key=lambda other: fits[other].cost, default=order)
            if fits[least].cost < fits[order].cost:
                again = self.solve(
                    order, embedded(fits[least].vector, least, order, self.rate))
                fits[order] = min(fits[order], again, key=lambda fit: fit.cost)

    @staticmethod
    def _leads_to(wanted: ResponseOrder, order: ResponseOrder, most_modes: int) -> bool:
        """Whether antiresonances, of which every mode brings one at most, can still be as many."""
        if wanted.antiresonances is None:
            return True
        return 0 <= wanted.antiresonances - order.antiresonances <= most_modes - order.modes

    def _keep(
        self, fits: dict[ResponseOrder, _Fit], found: Mapping[ResponseOrder, _Fit],
        wanted: ResponseOrder, most_states: int,
    ) -> None:
        """File fits, and those with other numbers of creep pairs that begin from them."""
        fits |= found
        counts = range(MOST_CREEP_PAIRS + 1) if wanted.creep_pairs is None else [wanted.creep_pairs]
        for (order, fit), count in product(found.items(), counts):
            other = replace(order, creep_pairs=count)
            allowed = wanted.modes is not None or other.states <= most_states
            if other != order and allowed and wanted.grants(other):
                starts = [self._with_creep(fit.vector, order, count)]
                if count > order.creep_pairs:
                    starts.append(embedded(fit.vector, order, other, self.rate))
                fits[other] = min((self.solve(other, start) for start in starts),
                                  key=lambda entry: entry.cost)

    def _plain_start(self, order: ResponseOrder) -> FloatArray:
        """Gain, lag and delay of a response without modes, and a slight creep."""
        level = np.abs(self.measured.gain[: max(1, self.rate.size // 4)]).mean()
        slow = self._slow_rates(order.creep_pairs)
        return np.concatenate([
            [self.delay_s / self.longest_delay_s],
            np.log([level, *slow, *(1.1 * slow), 2.0 / self.rate[-1]]),
        ])

    def _slow_rates(self, count: int) -> FloatArray:
        """Rates spread over the lower half of the measured decades."""
        middle = np.sqrt(self.rate[0] * self.rate[-1])
        return np.geomspace(self.rate[0], middle, count + 2)[1:-1]

    def _with_creep(self, vector: FloatArray, order: ResponseOrder, count: int) -> FloatArray:
        """Return the vector with this number of creep pairs."""
        head, tail = vector[:2], vector[2 + 2 * order.creep_pairs :]
        slow = self._slow_rates(count)
        return np.concatenate([head, np.log(slow), np.log(1.1 * slow), tail])

    def _best_further_mode(
        self, order: ResponseOrder, vector: FloatArray, grown: ResponseOrder,
    ) -> _Fit:
        """Fit with one more mode, and maybe antiresonance, begun at every resonance.

        Begun too where the mode adds nothing: above the band, or with an antiresonance upon it.
        """
        parts = np.split(vector, 2 + np.cumsum([
            2 * order.creep_pairs + 1, order.modes, order.modes,
            *2 * [order.antiresonances]]))
        has_zero = grown.antiresonances > order.antiresonances
        # Just beside the mode: that side of it on which the antiresonance lies is not known.
        starts: list[tuple[float, float, list[float]]] = [
            (abs(pole), max(-pole.real / abs(pole), 1e-3), [place * abs(pole)] * has_zero)
            for pole in self.resonances for place in ((0.95, 1.05) if has_zero else (1.0,))]
        idle = float(np.sqrt(self.rate[0] * self.rate[-1])) if has_zero else (
            0.9 * FASTEST * self.rate[-1])
        starts.append((idle, LAGGING_DAMPING, [idle] * has_zero))
        if not has_zero:
            lagging = np.geomspace(0.1 * self.rate[-1], self.rate[-1], LAGGING_STARTS)
            starts += [(frequency, LAGGING_DAMPING, []) for frequency in lagging.tolist()]
        quick = []
        for frequency, damping, zero in starts:
            start = np.concatenate([
                parts[0], parts[1], [np.log(frequency)], parts[2], [np.log(damping)],
                parts[3], np.log(zero), parts[4], np.log([damping] * len(zero)), parts[5],
            ])
            quick.append(self.solve(grown, start, QUICK_EVALUATIONS))
        return self.solve(grown, min(quick, key=lambda fit: fit.cost).vector)

    def solve(
        self, order: ResponseOrder, start: FloatArray, evaluations: int = 80,
    ) -> _Fit:
        """Fit of least squares from a start."""
        lower, upper = self._bounds(order)
        solution = least_squares(
            self._residual, np.clip(start, lower + 1e-6, upper - 1e-6), jac=self._jacobian,
            bounds=(lower, upper), args=(order,), x_scale="jac", max_nfev=evaluations,
        )
        refusal = lack_of_standing(
            solution.x, order, parameter_covariance(solution.jac, solution.fun), self.rate[-1])
        return _Fit(solution.x, solution.fun, solution.jac,
                    order_trial(order, solution.fun, solution.x.size, refusal))

    def _bounds(self, order: ResponseOrder) -> FloatArray:
        """Bound the parameters by what the measured frequencies can show."""
        slowest, fastest = np.log(0.1 * self.rate[0]), np.log(10.0 * self.rate[-1])
        creep = np.log(np.sqrt(self.rate[0] * self.rate[-1]))
        band = np.log([0.9 * self.rate[0], FASTEST * self.rate[-1]])
        damping = np.log([1e-5, 2.0])
        limits = [[0.0, 2.0], [-46.0, 46.0]]
        limits += 2 * order.creep_pairs * [[slowest, creep]]
        limits += [[-fastest, -np.log(self.rate[0])]]
        limits += order.modes * [band] + order.modes * [damping]
        limits += order.antiresonances * [band] + order.antiresonances * [damping]
        limits += order.beside * [band] + order.beside * [np.log(SIDE_DAMPINGS)]
        limits += order.beside * [SIDE_PARTS]
        return np.array(limits).T

    def _residual(self, vector: FloatArray, order: ResponseOrder) -> FloatArray:
        check_cancelled()
        difference = self.model(vector, order).response(self.measured.frequency_hz)
        difference = difference - self.measured.gain
        return np.concatenate([difference.real, difference.imag])

    def _jacobian(self, vector: FloatArray, order: ResponseOrder) -> FloatArray:
        """Differentiate the response: its own value times the derivatives of its logarithm."""
        s = 1j * self.rate[:, None]
        model = self.model(vector, order)
        poles, zeros = (np.array(rates)[None, :] for rates in (
            model.creep.poles_rad_per_s, model.creep.zeros_rad_per_s))
        lag = model.dynamics.time_constant_s * s
        by_mode = _quadratic_slopes(
            s, model.dynamics.mode_frequencies_rad_per_s, model.dynamics.damping_ratios)
        by_antiresonance = _quadratic_slopes(
            s, model.dynamics.antiresonance_frequencies_rad_per_s,
            model.dynamics.antiresonance_damping_ratios)
        whole = model.response(self.measured.frequency_hz)[:, None]
        series = whole
        if model.beside:
            series = replace(model, beside=()).response(self.measured.frequency_hz)[:, None]
        in_series = np.hstack([*(-slope for slope in by_mode), *by_antiresonance])
        slopes = [
            np.hstack([-s * self.longest_delay_s, np.ones_like(s), -poles / (s + poles),
                       zeros / (s + zeros), -lag / (1.0 + lag)]) * whole,
            in_series * series * (1.0 - sum(mode.participation for mode in model.beside)),
            *self._slopes_beside(model, series),
        ]
        columns = np.hstack(slopes)
        return np.vstack([columns.real, columns.imag])

    def _slopes_beside(self, model: ResponseModel, series: ComplexArray) -> list[ComplexArray]:
        """Differentiate by frequencies, dampings and parts of the modes beside those in series."""
        if not model.beside:
            return []
        s = 1j * self.rate[:, None]
        frequencies, dampings, parts = (tuple(numbers) for numbers in zip(
            *map(astuple, model.beside), strict=True))
        alone = replace(model, dynamics=replace(
            model.dynamics, mode_frequencies_rad_per_s=(), damping_ratios=(),
            antiresonance_frequencies_rad_per_s=(), antiresonance_damping_ratios=()), beside=())
        before = alone.response(self.measured.frequency_hz)[:, None]
        ratio = s / np.array(frequencies)
        own = before / (ratio**2 + 2.0 * np.array(dampings) * ratio + 1.0)
        return [*(-slope * own * np.array(parts)
                  for slope in _quadratic_slopes(s, frequencies, dampings)), own - series]

    def model(self, vector: FloatArray, order: ResponseOrder) -> ResponseModel:
        """Model with these parameters."""
        positive, parts = np.split(vector[1:], [vector.size - 1 - order.beside])
        fields = self.fields(np.append(np.exp(positive), parts), vector[0], order)
        return ResponseModel(
            fields["gain"], fields["delay_s"], CreepDynamics(**fields["creep"]),
            ElectricVibrationDynamics(**fields["dynamics"]),
            tuple(VibrationMode(**mode) for mode in fields["beside"]),
        )

    def fields(
        self, values: FloatArray, delay: float, order: ResponseOrder,
    ) -> dict[str, Any]:
        """Fields of a model, or their standard deviations, from one number for each parameter."""
        gain, poles, zeros, rest, *side = np.split(values, np.cumsum([
            1, *2 * [order.creep_pairs], 1 + 2 * (order.modes + order.antiresonances),
            *2 * [order.beside]]))
        return {
            "gain": float(gain[0]), "delay_s": float(delay * self.longest_delay_s),
            "creep": {"poles_rad_per_s": tuple(poles.tolist()),
                      "zeros_rad_per_s": tuple(zeros.tolist())},
            "dynamics": split_dynamics_vector(rest, order.modes, order.antiresonances),
            "beside": [dict(zip(MODE_FIELDS, map(float, numbers), strict=True))
                       for numbers in zip(*side, strict=True)],
        }


def _quadratic_slopes(
    s: ComplexArray, frequencies: tuple[float, ...], dampings: tuple[float, ...],
) -> tuple[ComplexArray, ComplexArray]:
    """Slopes of the logarithm of s^2 / w^2 + 2 d s / w + 1 by those of w and of d."""
    ratio, damping = s / np.array(frequencies)[None, :], np.array(dampings)[None, :]
    quadratic = ratio**2 + 2.0 * damping * ratio + 1.0
    by_damping = 2.0 * damping * ratio / quadratic
    return -2.0 * ratio**2 / quadratic - by_damping, by_damping
