# SPDX-License-Identifier: BSD-3-Clause
"""Electric lag, vibration modes, antiresonances, sensor lag and delay of least output error."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.residual.sensor_noise import noise_floor_um
from piezo_identification.estimators.dynamics.fast_dynamics import (
    ModeOrder,
    ascending_places,
    fast_dynamics_of,
    split_deviations,
    values_of,
)
from piezo_identification.estimators.dynamics.fast_record import (
    BESIDE_DAMPING,
    EARLIEST,
    FastFit,
    FastRecord,
    FreeFit,
)
from piezo_identification.estimators.dynamics.fit_deviations import (
    delay_deviation,
    fit_covariance,
    is_told,
)
from piezo_identification.estimators.dynamics.nested_start import nested_start
from piezo_identification.estimators.dynamics.physical_standing import lack_of_standing
from piezo_identification.estimators.dynamics.pole_search import QUICK_EVALUATIONS, free_fits
from piezo_identification.estimators.estimate import (
    DelayEstimate,
    Estimate,
    OrderTrial,
    finest_power,
    order_trial,
)

MOST_MODES = 8
"""Vibration modes beyond which the search for their number ends."""

ROWS_OF_SEARCH, ROWS_OF_TRIALS = 3000, 10_000
"""Rows of a longer record in which starts are sought, and in which orders are compared; the fit of
the order that is taken has all rows."""

LAST_EVALUATIONS = 4
"""Steps in the rows of the trials of poles that were found in fewer."""

POLISHING, ROUNDING = 200, 1e-12
"""Steps, and relative change of the cost, of the fit of the order that is taken."""

PATIENCE = 2
"""Numbers of modes in succession that may bring no gain before the search ends."""

STILL_MUCH = 0.5
"""Part of the power to which a further mode with free residues has to bring it down to be a gain,
whatever the forms make of it."""

LACKING, WORTHWHILE_PART = 10.0, 0.02
"""Where so many times the noise is left, a further mode has to explain this part of its power: tens
of thousands of samples call every mode significant that bends to what no linear dynamics make."""

MODES_LEFT_OUT = 2
"""Dynamics richer by up to so many modes are fitted, and the modes taken that explain most: those
that ring longest are not those that move a stage most."""

MOST_IN_SERIES = 2
"""Modes one after the other where others stand beside them; more are the same in other words."""

NEAR_DELAYS = (0.0, -3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0)
"""Sample periods by which a form may be better delayed than the fit with free residues."""

USUAL_DELAYS = (-1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0)
"""Sample periods that are tried whatever the fit with free residues says: it may take the waiting
of slow modes for a delay."""

FOLLOWED = 3
"""Starts of a form that are followed by quick fits."""

ENDED = 2
"""So many of the best of those starts are followed to their end."""

LAGGING_FORMS = 2
"""Forms, the best of as many modes, that are tried with a sensor's lag."""

SENSOR_LAGS = (0.3, 1.0, 4.0)
"""In sample periods, from which a sensor's lag is sought."""

WORTHWHILE = 10.0
"""Information that forms with modes beside others have to be able to gain before they are tried:
most often the same response can be told by modes in series with antiresonances (4.3)."""

NESTED_ROUNDS = 3
"""Passes over the orders in which one that leaves more than a smaller one begins from that one."""


def fit_output_error(
    record: FastRecord, mode_count: int | None = None, delay: float | None = None,
) -> Estimate:
    """Electric and vibration dynamics (4.3) and a delay of least output error.

    Poles with free residues come first, for more and more modes. From them begin the physical
    forms: modes one after the other, as in (4.3); the same with the antiresonances that modes
    which move side by side leave between them; modes that add their part of the displacement; and
    each of these with a sensor that lags. A larger order that leaves more than a smaller one begins
    from that one again. A form is refused whose numbers have no physical standing, see
    `physical_standing.lack_of_standing`; of the others, that of the least Bayesian information
    criterion is taken.

    Parameters
    ----------
    record : FastRecord
    mode_count : int, optional
        Number of modes, one after the other and without antiresonances; by default as many of
        both as the criterion justifies.
    delay : float, optional
        In sample periods, where it is known; by default it is fitted beside, and left out if it
        does not differ significantly from none.

    Returns
    -------
    Estimate
        Its order is a `ModeOrder`.
    """
    search = _Search(record, delay)
    if mode_count is None:
        search.try_all_orders()
    else:
        search.try_modes_in_series(mode_count)
    search.begin_again_from_smaller_orders()
    return search.estimate(mode_count is not None)


_Start = tuple[FloatArray, float]
"""Vector and delay from which a fit begins."""


class _Search:
    """Fits of a record by order."""

    def __init__(self, record: FastRecord, delay: float | None) -> None:
        self._whole, self._known_delay = record, delay
        self._record, self._coarse = (
            record.thinned(rows) for rows in (ROWS_OF_TRIALS, ROWS_OF_SEARCH))
        self._noise_um = noise_floor_um(record.measured_um, record.input.sample_period_s)
        self._fits: dict[ModeOrder, FastFit] = {}
        self._trials: dict[ModeOrder, OrderTrial] = {}

    def try_all_orders(self) -> None:
        """Fit every order until more modes bring no gain."""
        without_gain, before, left = 0, np.inf, np.inf
        for free in self._free_fits(MOST_MODES):
            if self._could_gain(free):
                self._try_forms(free)
            least = self._best_trial()
            information = np.inf if least is None else least.information
            # Too few modes may have no standing at all, as each stands for several.
            is_gain = information < before or free.cost < STILL_MUCH * left
            without_gain = 0 if is_gain else without_gain + 1
            before, left = information, free.cost
            if without_gain == PATIENCE:
                break

    def try_modes_in_series(self, count: int) -> None:
        """Fit a number of modes in series, begun from those that explain most of richer ones."""
        order = ModeOrder(count)
        for free in self._free_fits(count + MODES_LEFT_OUT):
            if free.modes < count:
                continue
            choices = [(_chosen(free.vector, modes)) for modes in _subsets(free.modes, count)]
            best = min(choices, key=lambda vector: self._coarse.parts(
                [(order, vector)], free.delay)[1])
            self._keep(order, [(best, free.delay)])

    def begin_again_from_smaller_orders(self) -> None:
        """Begin orders that leave more than a smaller one from that one."""
        for _ in range(NESTED_ROUNDS):
            changed = False
            # The smallest first, so that what one gains reaches all that hold it.
            for order in sorted(self._fits, key=lambda order: order.parameters):
                fit = self._fits[order]
                smaller = [other for other in self._fits.values()
                           if other.order != order and order.holds(other.order)]
                least = min(smaller, key=lambda other: other.cost, default=fit)
                if least.cost < fit.cost:
                    self._keep(order, [nested_start(
                        least, order, self._record.input.sample_period_s)])
                    changed = changed or self._fits[order].cost < fit.cost
            if not changed:
                break

    def estimate(self, order_given: bool) -> Estimate:
        """Return the best order, its delay left out if it is not significant."""
        trials = tuple(self._trials.values())
        chosen = self._best_trial() or min(trials, key=lambda trial: trial.information)
        fit, delay = self._polished(self._fits[chosen.order]), None
        if self._known_delay is None:
            fit, delay = self._with_delay_told(fit)
        deviations = np.sqrt(np.diag(fit_covariance(fit, self._whole.linear_parameters)))
        places = ascending_places(fit.vector, fit.order)
        model = fast_dynamics_of(fit.vector, fit.order)
        spread = deviations[: places.size] * np.where(
            np.arange(places.size) < places.size - fit.order.beside,
            values_of(fit.vector, fit.order), 1.0)
        of_dynamics, of_effects = split_deviations(spread[places], fit.order)
        return Estimate(
            model.dynamics, of_dynamics, chosen.order, trials, order_given,
            effects=model.effects(), effect_deviations=of_effects, delay=delay)

    def _with_delay_told(self, fit: FastFit) -> tuple[FastFit, DelayEstimate]:
        """Return the fit and its delay; the fit without it where it is not significant."""
        of_phase = self._whole.phase_room**2 / 3.0
        variance = of_phase + float(fit_covariance(fit, self._whole.linear_parameters)[-1, -1])
        without = None if is_told(fit, variance) else self._whole.fit(
            fit.order, fit.vector, 0.0, is_delay_free=False)
        period_s = self._record.input.sample_period_s
        deviation = max(delay_deviation(fit, without, variance), np.sqrt(of_phase))
        delay = DelayEstimate(fit.delay * period_s, deviation * period_s, period_s)
        # Where the instant of the input is open, a delay that is not told stands for that.
        if not delay.is_significant and not of_phase:
            fit = without or self._whole.fit(fit.order, fit.vector, 0.0, is_delay_free=False)
        return fit, delay

    def _free_fits(self, most_modes: int) -> Iterator[FreeFit]:
        for free in free_fits(self._coarse, most_modes):
            yield free if self._coarse is self._record else self._record.fit_free(
                free.vector, free.delay, LAST_EVALUATIONS)

    def _polished(self, fit: FastFit) -> FastFit:
        return self._whole.fit(
            fit.order, fit.vector, fit.delay, POLISHING, self._known_delay is None, ROUNDING)

    def _best_trial(self) -> OrderTrial | None:
        """Trial of the least information among those with physical standing."""
        return min((trial for trial in self._trials.values() if not trial.refusal),
                   key=lambda trial: trial.information, default=None)

    def _could_gain(self, free: FreeFit) -> bool:
        """Whether a mode, two numbers, could pay with the least that any form leaves."""
        samples, best = free.residual.size, self._best_trial()
        if best is None:
            return True
        left = samples * best.residual_rms**2
        is_much = best.residual_rms > LACKING * self._noise_um
        if is_much and free.cost > (1.0 - WORTHWHILE_PART) * left:
            return False
        rounding = samples * finest_power(self._record.measured_um)
        gain = samples * np.log((left + rounding) / (free.cost + rounding))
        return bool(gain > 2.0 * np.log(samples))

    def _try_forms(self, free: FreeFit) -> None:
        """Fit the physical forms with as many modes as a free fit, and the best with a lag."""
        found = [self._keep(order, starts) for order, starts in self._with_antiresonances(free)]
        standing = self._best_trial()
        known = [self._fits[standing.order]] if standing else []
        # No form leaves less than free residues: what modes beside others could gain at most.
        gain = free.residual.size * np.log(
            min(fit.cost for fit in [*found, *known]) / free.cost)
        if gain > WORTHWHILE:
            found += [self._keep(order, starts) for order, starts in self._with_modes_beside(free)]
            found.sort(key=lambda fit: self._trials[fit.order].information)
            for fit in found[:LAGGING_FORMS]:
                self._try_sensor_lag(fit)

    def _try_sensor_lag(self, fit: FastFit) -> None:
        order = replace(fit.order, sensor_lags=1)
        period_s = self._record.input.sample_period_s
        place = fit.vector.size - fit.order.beside
        self._keep(order, [
            (np.insert(fit.vector, place, np.log(lag * period_s)), fit.delay - lag)
            for lag in SENSOR_LAGS])

    def _with_antiresonances(self, free: FreeFit) -> Iterator[tuple[ModeOrder, list[_Start]]]:
        """Modes in series, with none and more and more of the zeros of the free fit."""
        zeros = free.antiresonances()
        # Between modes there is one antiresonance fewer than there are modes.
        for count in range(min(zeros.shape[1], max(free.modes - 1, 0)) + 1):
            order = ModeOrder(free.modes, count)
            choices = [np.concatenate([free.vector, *np.log(zeros[:, list(chosen)])])
                       for chosen in combinations(range(zeros.shape[1]), count)]
            yield order, self._best_starts([
                (self._coarse.parts([(order, choice)], delay)[1], choice, delay)
                for choice in choices for delay in self._delays_near(free.delay)])

    def _with_modes_beside(self, free: FreeFit) -> Iterator[tuple[ModeOrder, list[_Start]]]:
        """Few modes in series, and the others beside them."""
        for count in range(min(MOST_IN_SERIES, free.modes - 1) + 1):
            rated = []
            for chosen, delay in product(
                    _subsets(free.modes, count), self._delays_near(free.delay)):
                others = [_chosen(free.vector, (i,)) for i in range(free.modes) if i not in chosen]
                rated.append(self._side_by_side(_chosen(free.vector, chosen), others, delay))
            # A mode that is damped beyond what one beside others may be belongs in series.
            rated = [start for start in rated if _may_stand_beside(start[1], count)] or rated
            rated += self._with_one_more_beside(free, count)
            yield ModeOrder(count, 0, free.modes - count), self._best_starts(rated)

    def _with_one_more_beside(
        self, free: FreeFit, count: int,
    ) -> list[tuple[float, FloatArray, float]]:
        """Put a mode of the free fit beside those of the form with one mode fewer."""
        order = ModeOrder(count, 0, free.modes - count - 1)
        smaller = self._fits.get(order)
        if smaller is None:
            return []
        main, frequencies, dampings, _ = np.split(
            smaller.vector, np.cumsum([1 + 2 * count, order.beside, order.beside]))
        beside = [np.array([main[0], *mode])
                  for mode in zip(frequencies, dampings, strict=True)]
        modes = [_chosen(free.vector, (i,)) for i in range(free.modes)]
        return [self._side_by_side(main, [*beside, np.append(main[0], mode[1:])], smaller.delay)
                for mode in modes]

    def _side_by_side(
        self, main: FloatArray, beside: list[FloatArray], delay: float,
    ) -> tuple[float, FloatArray, float]:
        """Rate lag and modes in series, and others beside, by the parts that explain most."""
        gains, cost = self._coarse.parts(
            [(ModeOrder(main.size // 2), main), *((ModeOrder(1), each) for each in beside)], delay)
        numbers = np.array(beside)
        return cost, np.concatenate([
            main, numbers[:, 1], numbers[:, 2], gains[1:] / (gains.sum() or 1.0)]), delay

    def _delays_near(self, delay: float) -> list[float]:
        if self._known_delay is not None:
            return [self._known_delay]
        delays = {delay + by for by in NEAR_DELAYS} | set(USUAL_DELAYS)
        return sorted(each for each in delays if each >= EARLIEST)

    @staticmethod
    def _best_starts(rated: list[tuple[float, FloatArray, float]]) -> list[_Start]:
        """Return the starts of least cost, with different delays."""
        best: dict[float, _Start] = {}
        for _, vector, delay in sorted(rated, key=lambda entry: entry[0]):
            best.setdefault(delay, (vector, delay))
        return list(best.values())[:FOLLOWED]

    def _keep(self, order: ModeOrder, starts: Iterable[_Start]) -> FastFit:
        """Fit an order from the best of several starts, and keep it if it leaves less."""
        is_free = self._known_delay is None
        quick = [
            self._coarse.fit(order, vector, delay if self._known_delay is None
                             else self._known_delay, QUICK_EVALUATIONS, is_free)
            for vector, delay in starts]
        quick.sort(key=lambda fit: fit.cost)
        best = min(
            (self._record.fit(order, fit.vector, fit.delay, is_delay_free=is_free)
             for fit in quick[:ENDED]), key=lambda fit: fit.cost)
        if order not in self._fits or best.cost < self._fits[order].cost:
            self._fits[order], self._trials[order] = best, self._trial(best)
        return self._fits[order]

    def _parameters(self, order: ModeOrder) -> int:
        return order.parameters + self._record.linear_parameters + (self._known_delay is None)

    def _trial(self, fit: FastFit) -> OrderTrial:
        parameters = self._parameters(fit.order)
        refusal = lack_of_standing(
            fit.vector, fit.order, fit_covariance(fit, self._record.linear_parameters),
            self._record.input.sample_period_s)
        return order_trial(
            fit.order, fit.residual, parameters, refusal, self._record.measured_um)


def _subsets(count: int, size: int) -> Iterator[tuple[int, ...]]:
    return combinations(range(count), size)


def _may_stand_beside(vector: FloatArray, modes: int) -> bool:
    """Whether the modes beside those in series are damped as little as they have to be."""
    beside = (vector.size - 1 - 2 * modes) // 3
    first = 1 + 2 * modes + beside
    return bool(np.all(vector[first : first + beside] < np.log(BESIDE_DAMPING[1])))


def _chosen(vector: FloatArray, modes: tuple[int, ...]) -> FloatArray:
    """Lag and some of the modes of a vector of modes in series."""
    lag, frequencies, dampings = np.split(vector, [1, 1 + vector.size // 2])
    return np.concatenate([lag, frequencies[list(modes)], dampings[list(modes)]])
