# SPDX-License-Identifier: BSD-3-Clause
"""Electric lag, vibration modes, antiresonances, sensor lag and delay of least output error."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.side_by_side import side_by_side
from piezo_identification.conditioning.row_alignment import SIGNIFICANT
from piezo_identification.estimators.dynamics.fast_dynamics import (
    ModeOrder,
    ascending_places,
    coupled_vector,
    fast_dynamics_of,
    split_deviations,
    values_of,
)
from piezo_identification.estimators.dynamics.fast_record import (
    EARLIEST,
    FastFit,
    FastRecord,
    FreeFit,
    bounds_of,
)
from piezo_identification.estimators.dynamics.fit_deviations import (
    delay_deviation,
    fit_covariance,
)
from piezo_identification.estimators.dynamics.pole_search import MOST_MODES, free_fits
from piezo_identification.estimators.estimate import DelayEstimate, Estimate, OrderTrial
from piezo_identification.fitting.evidence import INDEPENDENT
from piezo_models.effects.vibration_mode import VibrationMode

ROWS_OF_SEARCH, ROWS_OF_TRIALS, ROWS_OF_FIT = 3000, 10_000, 20_000
"""Number of rows of a longer record used to find starts, to compare orders, and to fit the chosen
order."""

QUICK_EVALUATIONS = 12
"""Number of steps that distinguish good starts from bad ones."""

POLISHING, ROUNDING = 200, 1e-12
"""Number of steps, and relative change of the cost, of the final fit of the chosen order."""

MODES_LEFT_OUT = 2
"""Dynamics with up to so many additional modes are fitted, and the most important modes kept: the
modes that ring longest are not those with the largest displacement."""

MOST_IN_SERIES = 2
"""Largest number of modes in series together with parallel ones; larger forms are equivalent."""

NEAR_DELAYS = (0.0, -3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0)
"""Delays that are tried, in sample periods relative to that of the fit with free residues."""

FOLLOWED = 3
"""Number of starts of a form that are refined by quick fits; the best is fitted to the end."""

HOPELESS = 1000.0
"""Ratio to the residual power of free residues above which a form is not fitted to the end. The lag
of a sensor that is yet to be found may leave a hundred times as much."""

MOST_RESIDUAL = 10.0
"""Residual, relative to the least, up to which an order is preferred to others that contradict the
known loops."""

CONTRADICTS = "a gain that the loops do not have"
"""Why those are then refused."""

LAGGING_FORMS = 2
"""Number of forms, the best of as many modes, that are tried with a sensor lag."""

ORDERS = 0.3
"""Share of the time limit after which no further orders are tried."""

SENSOR_LAGS = (0.3, 1.0, 4.0)
"""Initial values of a sensor lag, in sample periods."""


def fit_output_error(
    record: FastRecord, mode_count: int | None = None, delay: float | None = None,
    among: Collection[ModeOrder] = (),
) -> Estimate:
    """Electric and vibration dynamics (4.3) and a delay of least output error.

    Poles with free residues are fitted first, as many as the evidence supports. They are themselves
    a model, of coupled modes. They are the starting point for forms with fewer parameters: modes in
    series, as in (4.3); modes in series with antiresonances, as parallel modes produce them;
    parallel modes that add up to the displacement; and each of these with a sensor lag. The form
    with the most evidence is chosen.

    Parameters
    ----------
    mode_count : int, optional
        Number of modes in series without antiresonances; by default as many of both as the
        criterion justifies.
    delay : float, optional
        Delay in sample periods, if it is known; by default it is fitted, and omitted if it is not
        significant.
    among : collection of ModeOrder
        Orders to which the search is restricted, if any of them has the number of modes that the
        evidence supports; by default all orders are tried.

    Returns
    -------
    Estimate
        Its order is a `ModeOrder`.
    """
    search = _Search(record, delay, among)
    if mode_count is None:
        search.try_all_orders()
    else:
        search.try_modes_in_series(mode_count)
    return search.estimate(mode_count is not None)


_Start = tuple[FloatArray, float]
"""Vector and delay from which a fit starts."""


class _Search:
    """Fits of a record by order."""

    def __init__(self, record: FastRecord, delay: float | None,
                 among: Collection[ModeOrder] = ()) -> None:
        self._whole, self._known_delay = record.thinned(ROWS_OF_FIT), delay
        self._among = among
        self._record, self._coarse = (
            record.thinned(rows) for rows in (ROWS_OF_TRIALS, ROWS_OF_SEARCH))
        self._fits: dict[ModeOrder, FastFit] = {}
        self._independent = INDEPENDENT

    def try_all_orders(self) -> None:
        """Fit the forms with as many modes as the evidence of free residues supports."""
        frees = list(free_fits(self._coarse, MOST_MODES))
        self._independent = self._coarse.independent_errors(frees[-1])
        best = int(np.argmax([self._coarse.log_evidence(free, free.numbers, self._independent)
                              for free in frees]))
        # A form with its own lag may need one mode less.
        with while_time_lasts("further orders of the dynamics", ORDERS):
            for free in frees[max(0, best - 1) : best + 1]:
                self._try_forms(free)
            # Of free poles that follow errors of the loops, none may be a mode.
            for free in reversed(frees[: max(0, best - 1)]):
                if self._fits and not self._record.contradicts_loops(
                        min(self._fits.values(), key=self._information)):
                    break
                self._try_forms(free)
        if not self._fits:
            self._among = ()
            self._try_forms(frees[best])

    def try_modes_in_series(self, count: int) -> None:
        """Fit a number of modes in series, starting from the most important ones of larger fits."""
        order = ModeOrder(count)
        for free in free_fits(self._coarse, count + MODES_LEFT_OUT):
            if free.modes < count:
                continue
            choices = [_chosen(free.vector, modes)
                       for modes in combinations(range(free.modes), count)]
            best = min(choices, key=lambda vector: self._coarse.parts(
                [(order, vector)], free.delay)[1])
            self._keep([self._fit(order, [(best, free.delay)])])

    def estimate(self, order_given: bool) -> Estimate:
        """Return the best order, without its delay if that is not significant."""
        trials = self._trials()
        chosen = min(trials, key=lambda trial: (bool(trial.refusal), trial.information))
        fit, delay = self._polished(self._fits[chosen.order]), None
        if self._known_delay is None:
            fit, delay = self._with_delay_decided(fit)
        deviations = np.sqrt(np.diag(fit_covariance(fit, self._whole.linear_parameters)))
        places = ascending_places(fit.vector, fit.order)
        dynamics, effects = fast_dynamics_of(fit.vector, fit.order)
        spread = deviations[: places.size] * np.where(
            np.arange(places.size) < fit.order.positive, values_of(fit.vector, fit.order), 1.0)
        of_dynamics, of_effects = split_deviations(spread[places], fit.order)
        return Estimate(
            dynamics, of_dynamics, chosen.order, trials, order_given,
            effects=effects, effect_deviations=of_effects, delay=delay)

    def _with_delay_decided(self, fit: FastFit) -> tuple[FastFit, DelayEstimate]:
        """Return the fit and its delay; the fit is without delay if that is not significant."""
        of_phase = self._whole.phase_room**2 / 3.0
        variance = of_phase + float(fit_covariance(fit, self._whole.linear_parameters)[-1, -1])
        is_certain = abs(fit.delay) > SIGNIFICANT * np.sqrt(variance)
        without = None if is_certain else self._whole.fit(
            fit.order, fit.vector, 0.0, is_delay_free=False)
        period_s = self._record.input.sample_period_s
        deviation = max(delay_deviation(fit, without, variance), np.sqrt(of_phase))
        delay = DelayEstimate(fit.delay * period_s, deviation * period_s, period_s)
        # If the instant of the input is unknown, a delay that is not identifiable represents it.
        if not delay.is_significant and not of_phase:
            fit = without or self._whole.fit(fit.order, fit.vector, 0.0, is_delay_free=False)
        return fit, delay

    def _polished(self, fit: FastFit) -> FastFit:
        return self._whole.fit(
            fit.order, fit.vector, fit.delay, POLISHING, self._known_delay is None, ROUNDING)

    def _trials(self) -> tuple[OrderTrial, ...]:
        """Return all fits; those that contradict the loops are refused if another one is usable."""
        trials = [OrderTrial(
            order, self._numbers(order), float(np.sqrt(fit.cost / fit.residual.size)),
            self._information(fit), self._record.beyond_record(fit))
            for order, fit in self._fits.items()]
        most = MOST_RESIDUAL * min(trial.residual_rms for trial in trials)
        contradict = {order for order, fit in self._fits.items()
                      if self._record.contradicts_loops(fit)}
        if any(trial.residual_rms <= most and not trial.refusal
               and trial.order not in contradict for trial in trials):
            trials = [replace(trial, refusal=trial.refusal or CONTRADICTS)
                      if trial.order in contradict else trial for trial in trials]
        return tuple(trials)

    def _try_forms(self, free: FreeFit) -> None:
        """Fit the free poles as a model, forms with as many modes, and the best with a lag."""
        # At least one form is fitted, whatever its error.
        most = HOPELESS * self._coarse.free(free.vector, free.delay).cost if (
            self._fits or free.modes) else np.inf

        def fitted(forms: Iterable[tuple[ModeOrder, list[_Start]]]) -> list[FastFit]:
            return [fit for order, starts in forms
                    if (fit := self._fit(order, starts, most)) is not None]

        coupled, *others = side_by_side(fitted, [
            self._as_coupled_modes(free), self._with_antiresonances(free),
            self._with_parallel_modes(free)])
        found = [fit for fits in others for fit in fits]
        self._keep(coupled + found)
        best = sorted(found, key=self._information)[:LAGGING_FORMS]
        self._keep(side_by_side(self._with_sensor_lag, best))

    def _information(self, fit: FastFit) -> float:
        return -2.0 * self._record.log_evidence(
            fit, self._numbers(fit.order), self._independent)

    def _with_sensor_lag(self, fit: FastFit) -> FastFit | None:
        order = replace(fit.order, sensor_lags=1)
        period_s = self._record.input.sample_period_s
        place = fit.order.positive
        return self._fit(order, [
            (np.insert(fit.vector, place, np.log(lag * period_s)), fit.delay - lag)
            for lag in SENSOR_LAGS])

    @staticmethod
    def _as_coupled_modes(free: FreeFit) -> Iterator[tuple[ModeOrder, list[_Start]]]:
        if free.modes:
            yield ModeOrder(0, 0, free.modes, is_coupled=True), [
                (coupled_vector(free.poles, free.residues), free.delay)]

    def _with_antiresonances(self, free: FreeFit) -> Iterator[tuple[ModeOrder, list[_Start]]]:
        """Yield modes in series with the zeros of the free fit, then one zero less each time."""
        zeros = np.log(free.antiresonances())
        chosen = list(range(zeros.shape[1]))

        def cost(kept: list[int], delay: float = free.delay) -> float:
            return self._coarse.parts([(ModeOrder(free.modes, len(kept)), vector(kept))], delay)[1]

        def vector(kept: list[int]) -> FloatArray:
            return np.concatenate([free.vector, *zeros[:, kept]])

        while True:
            # There are fewer antiresonances than modes, because they lie between them.
            if len(chosen) <= max(free.modes - 1, 0):
                yield ModeOrder(free.modes, len(chosen)), self._best_starts([
                    (cost(chosen, delay), vector(chosen), delay)
                    for delay in self._delays_near(free.delay)])
            if not chosen:
                return
            chosen = min(([each for each in chosen if each != left_out] for left_out in chosen),
                         key=cost)

    def _with_parallel_modes(self, free: FreeFit) -> Iterator[tuple[ModeOrder, list[_Start]]]:
        """Yield all modes in parallel, then one more of them in series each time."""
        series: tuple[int, ...] = ()

        def start(chosen: tuple[int, ...], delay: float) -> tuple[float, FloatArray, float]:
            others = [_chosen(free.vector, (i,)) for i in range(free.modes) if i not in chosen]
            return self._side_by_side(_chosen(free.vector, chosen), others, delay)

        def rank(chosen: tuple[int, ...]) -> tuple[bool, float]:
            # Modes with too much damping for a parallel mode must be in series.
            cost, vector, _ = start(chosen, free.delay)
            return not _may_be_parallel(vector, len(chosen)), cost

        for count in range(min(MOST_IN_SERIES, free.modes - 1) + 1):
            if count:
                series = min(((*series, i) for i in range(free.modes) if i not in series), key=rank)
            yield ModeOrder(count, 0, free.modes - count), self._best_starts([
                start(series, delay) for delay in self._delays_near(free.delay)])

    def _side_by_side(
        self, main: FloatArray, parallel: list[FloatArray], delay: float,
    ) -> tuple[float, FloatArray, float]:
        """Return cost and start of modes in series and parallel, with the best participations."""
        gains, cost = self._coarse.parts(
            [(ModeOrder(main.size // 2), main), *((ModeOrder(1), each) for each in parallel)],
            delay)
        numbers = np.array(parallel)
        return cost, np.concatenate([
            main, numbers[:, 1], numbers[:, 2], gains[1:] / (gains.sum() or 1.0)]), delay

    def _delays_near(self, delay: float) -> list[float]:
        if self._known_delay is not None:
            return [self._known_delay]
        return [delay + by for by in NEAR_DELAYS if delay + by >= EARLIEST]

    @staticmethod
    def _best_starts(rated: list[tuple[float, FloatArray, float]]) -> list[_Start]:
        """Return the starts with the lowest cost."""
        best = sorted(rated, key=lambda entry: entry[0])
        return [(vector, delay) for _, vector, delay in best[:FOLLOWED]]

    def _fit(self, order: ModeOrder, starts: Iterable[_Start],
             most: float = np.inf) -> FastFit | None:
        """Fit an order from the best of several starts; None if all of them exceed a cost."""
        if self._among and order not in self._among:
            return None
        is_free = self._known_delay is None
        quick = [
            self._coarse.fit(order, vector, delay if self._known_delay is None
                             else self._known_delay, QUICK_EVALUATIONS, is_free)
            for vector, delay in starts]
        best = min(quick, key=lambda fit: fit.cost)
        if best.cost > most:
            return None
        return self._record.fit(order, best.vector, best.delay, is_delay_free=is_free)

    def _keep(self, fits: Iterable[FastFit | None]) -> None:
        """Keep the best fit of each order."""
        for fit in fits:
            if fit is not None and (fit.order not in self._fits
                                    or fit.cost < self._fits[fit.order].cost):
                self._fits[fit.order] = fit

    def _numbers(self, order: ModeOrder) -> int:
        """Return the number of parameters of an order, including gain and delay."""
        return order.parameters + 1 + (self._known_delay is None)


def _may_be_parallel(vector: FloatArray, modes: int) -> bool:
    """Return whether the damping of all parallel modes is below its bound."""
    parallel = (vector.size - 1 - 2 * modes) // 3
    first = 1 + 2 * modes + parallel
    most = np.log(bounds_of(VibrationMode, "damping_ratio")[1])
    return bool(np.all(vector[first : first + parallel] < most))


def _chosen(vector: FloatArray, modes: tuple[int, ...]) -> FloatArray:
    """Return the lag and some modes of a vector of modes in series."""
    lag, frequencies, dampings = np.split(vector, [1, 1 + vector.size // 2])
    return np.concatenate([lag, frequencies[list(modes)], dampings[list(modes)]])
