# SPDX-License-Identifier: BSD-3-Clause
"""Creep from a long square wave, by output-error fit."""

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from piezo_common.arrays import FloatArray, IntArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.generator_edges import free_running_level
from piezo_identification.conditioning.settling import (
    MOST_OF_RECORDING,
    USUAL_SETTLING_S,
    low_frequency_delay_s,
    settling_time_s,
)
from piezo_identification.conditioning.waveforms import (
    SquareWave,
    played,
    samples_per_mean,
    square_part,
    square_wave,
)
from piezo_identification.estimators.creep.power_law import (
    POWER_LAW,
    continued,
    creep_of_point,
    end_of_law_rad_per_s,
    rates_of_law,
)
from piezo_identification.estimators.estimate import (
    ROWS_OF_DECAY,
    Estimate,
    OrderTrial,
    creep_of_partial_fractions,
    order_trial,
    parameter_covariance,
    propagated,
    without_span,
)
from piezo_identification.fitting.nonnegative_regression import nonnegative_least_squares
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

MORE_PAIRS, SHARE_OF_CREEP = "more pairs of the creep", 0.2
"""What is omitted when time is short, and the share of the time limit after which it is."""

MOST_PAIRS = 8
"""Largest number of pole and zero pairs that is tried."""

FAST = 0.99
"""Rate relative to the upper bound from which the bound limits it."""

BINS_PER_DECADE = 60
"""Bins for averaging after a step: creep needs no finer resolution in logarithmic time."""


FEWEST_STEPS = 2
"""Fewest steps with which the record returns to its first level, so that its loop can be
checked."""


class CreepNotShown(ValueError):
    """A recording does not show the requested number of pairs."""


def estimate_creep(
    recording: Recording, dynamics: ElectricVibrationDynamics | None = None,
    pair_count: int | None = None, delay_s: float = 0.0, highest_rad_per_s: float = 0.0,
) -> Estimate:
    """Estimate the creep dynamics (4.4) from a square wave of long period.

    Under a square wave the hysteresis is an offset and a gain (4.5). Both are free here, and so is
    the initial state of the creep, because the creep responds to the step of the offset as well.
    The mean measured displacement is then a sum of exponentials in the known voltage. The error of
    this output is minimised, not that of a one-step prediction: an equation-error fit such as ARMAX
    would attribute the step of the offset to creep.

    The state of the hysteresis before the first step is arbitrary. After it, the loop between the
    levels is closed: a return to a level gives the same output as before. If the Bayesian
    information criterion shows that the part before the first step is not on the loop, it is
    omitted.

    Parameters
    ----------
    recording : Recording
        Recording of the creep experiment.
    dynamics : ElectricVibrationDynamics, optional
        Known dynamics: they delay the creep, and their ringing after each step is omitted.
    pair_count : int, optional
        Number of pole and zero pairs; by default as many as the Bayesian information criterion
        justifies.
    delay_s : float
        Delay of the measurement in addition to the dynamics.
    highest_rad_per_s : float
        Highest frequency of the fast recordings, for a power law without known modes.

    Returns
    -------
    Estimate
        Its model is a `CreepDynamics`; its order counts pairs of pole and zero, or is the name of
        the power law.

    Raises
    ------
    ValueError
        If the recording has gaps or is no square wave, or does not show the requested pairs.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> creep = CreepDynamics(poles_rad_per_s=(0.5,), zeros_rad_per_s=(0.55,))
    >>> stage = StageModel(line, creep, ElectricVibrationDynamics())
    >>> time_s = 0.01 * np.arange(2000)
    >>> voltage_v = np.where(time_s % 10.0 < 5.0, 0.0, 10.0)
    >>> estimate = estimate_creep(recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 0.01)}))
    >>> print(np.round(estimate.model.poles_rad_per_s, 3))
    [0.5]
    >>> figure = estimate.plot()                   # why this order
    """
    part = square_part(played(recording))
    record = _CreepRecord(part, dynamics, delay_s, highest_rad_per_s)
    if record.wave.steps.size < FEWEST_STEPS:
        return _estimate(record, pair_count)
    later = part.select(np.arange(part.voltage_v.size) >= record.wave.steps[0])
    cut = _estimate(_CreepRecord(
        later, dynamics, delay_s, highest_rad_per_s), pair_count)
    whole = _estimate(record, pair_count)
    off_um = record.first_run_off_um(cut.model)
    if off_um == 0.0:
        return whole
    # With many slow exponentials, the level is certain to change, but not by how much.
    size = f"{off_um:+.3g} um " if abs(off_um) < np.ptp(part.displacement_um) else ""
    first_run_s = record.wave.steps[0] * record.period_s
    return replace(cut, start=f"its first {first_run_s:.4g} s, up to the first step, are "
                   f"{size}off the loop of the later ones: left out")


def left_out_s(dynamics: ElectricVibrationDynamics | None, delay_s: float = 0.0,
               step_s: float = np.inf) -> float:
    """Return the time after a step in which fast motion hides the creep.

    The time depends on the dynamics, because a fast stage may creep within milliseconds. It is at
    most the fraction `MOST_OF_RECORDING` of the longest step, which lasts `step_s`, however slowly
    a mode decays. If the dynamics are unknown (None or static), at least the usual time is omitted.
    The rows are late by `delay_s` in addition to the dynamics.
    """
    if dynamics is None or dynamics.is_static:
        return max(USUAL_SETTLING_S, delay_s)
    return min(settling_time_s(dynamics), MOST_OF_RECORDING * step_s) + max(delay_s, 0.0)


def longest_step_s(recording: Recording, wave: SquareWave) -> float:
    """Return the duration of the longest run between the steps of a square wave."""
    edges = [0, *wave.steps, wave.level.size]
    return float(np.max(np.diff(edges))) * recording.sample_period_s


def _estimate(record: "_CreepRecord", pair_count: int | None) -> Estimate:
    """Estimate with the steps at the samples, or between them for a free-running generator."""
    estimate = _estimate_as_held(record, pair_count)
    own = free_running_level(record.wave)
    if own is None:
        return estimate
    between = _estimate_as_held(record.as_held(own), pair_count)
    return min(estimate, between, key=lambda each: each.residual_rms)


def _estimate_as_held(record: "_CreepRecord", pair_count: int | None) -> Estimate:
    rates = np.empty(0)
    best, trials = rates, [record.trial(rates)]
    with while_time_lasts(MORE_PAIRS, 1.0 if pair_count else SHARE_OF_CREEP):
        for _ in range(MOST_PAIRS if pair_count is None else pair_count):
            rates = record.refine(np.append(rates, record.best_further_rate(rates)))
            trials.append(record.trial(rates))
            better = trials[-1].information < min(trial.information for trial in trials[:-1])
            if pair_count is None and not better:
                break
            best = rates
    law = record.power_law() if pair_count is None else None
    if law is not None:
        point, covariance, trial = law
        trials.append(trial)
        if trial.information < min(other.information for other in trials[:-1]):
            point, free = continued(point, record.end_of_law_rad_per_s)
            return Estimate(*creep_of_point(point, free, covariance), POWER_LAW, tuple(trials))
    model, standard_deviations = record.creep(best)
    shown = len(model.poles_rad_per_s)
    if pair_count is not None and shown < pair_count:
        raise CreepNotShown(
            f"{record.path} shows {shown} of {pair_count} pairs of creep poles and zeros; the "
            "others are too fast for the rows, or have no positive gain: ask for fewer, or record "
            "longer")
    return Estimate(model, standard_deviations, best.size, tuple(trials), pair_count is not None)


class _CreepRecord:
    """The averaged record, and the response of creep exponentials to its voltage."""

    def __init__(self, recording: Recording, dynamics: ElectricVibrationDynamics | None,
                 delay_s: float, highest_rad_per_s: float) -> None:
        self.path = recording.path
        self.wave = square_wave(recording)
        self.period_s = recording.sample_period_s
        self.mean_samples = samples_per_mean(recording)
        self.delay_s = delay_s
        if dynamics is not None:
            self.delay_s += low_frequency_delay_s(dynamics)
        self.settling_s = left_out_s(dynamics, delay_s, longest_step_s(recording, self.wave))
        self.held = self.wave.level
        self.time_s = np.arange(self.wave.level.size) * self.period_s
        self.bins, self.weights = self._logarithmic_bins()
        if not self.weights.any():
            raise ValueError(
                f"{recording.path} steps faster than every {self.settling_s:.3g} s, too fast to "
                "show creep: give the recording of a creep experiment"
            )
        self.displacement = self._average(recording.displacement_um)
        self.fastest = 1.0 / max(ROWS_OF_DECAY * self.period_s, self.settling_s / 3.0)
        self.bounds = np.log([0.3 / self.time_s[-1], self.fastest])
        self.end_of_law_rad_per_s = end_of_law_rad_per_s(dynamics, highest_rad_per_s)

    def as_held(self, level: FloatArray) -> "_CreepRecord":
        """Return the same record with a voltage that has this mean in each sample period."""
        result = copy(self)
        result.held = level
        return result

    def _logarithmic_bins(self) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the starts of the bins, alternating with the settling samples to omit."""
        # The fast motion is largest in the sample of a step.
        skipped = max(1, int(np.ceil(self.settling_s / self.period_s)))
        edges = np.concatenate([[0], self.wave.steps, [self.wave.level.size]])
        starts, weights = list[IntArray](), list[FloatArray]()
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            length = end - begin
            if length <= skipped:
                starts.append(np.array([begin]))
                weights.append(np.zeros(1))
                continue
            decades = np.log10(length / skipped)
            inner = np.unique(
                np.geomspace(skipped, length, int(BINS_PER_DECADE * decades) + 2).astype(int)
            )[:-1]
            starts.append(begin + np.concatenate([[0], inner]))
            weights.append(np.concatenate([[0.0], np.sqrt(np.diff(np.append(inner, length)))]))
        return np.concatenate(starts), np.concatenate(weights)

    def _average(self, samples: FloatArray) -> FloatArray:
        """Means over the bins, weighted to equal variance, (B,)."""
        counts = np.diff(np.append(self.bins, self.time_s.size))
        kept = self.weights > 0.0
        return (np.add.reduceat(samples, self.bins) / counts * self.weights)[kept]

    def _decay(self, rate: float, since: NDArray[np.intp] | int = 0) -> FloatArray:
        """Mean over each bin of an exponential that begins at a sample, (B,)."""
        kept = self.weights > 0.0
        counts = np.diff(np.append(self.bins, self.time_s.size))[kept]
        exponent = rate * self.period_s
        first = np.exp(-exponent * (self.bins[kept] - since))
        return first * np.expm1(-exponent * counts) / (counts * np.expm1(-exponent))

    def _deviation(self, rate: float) -> FloatArray:
        """Mean over each bin of an exponential lag's deviation from the level, 0 at first, (B,)."""
        edges = np.concatenate([[0], self.wave.steps])
        levels = self.wave.level[edges]
        # Part of the next level that a free-running generator reached before the step shows.
        early = (self.held - self.wave.level)[edges[1:] - 1] * -np.expm1(-rate * self.period_s)
        deviations = np.zeros(edges.size)
        for n, decay in enumerate(np.exp(-rate * self.period_s * np.diff(edges))):
            deviations[n + 1] = deviations[n] * decay + levels[n] - levels[n + 1] + early[n]
        run = np.searchsorted(edges, self.bins[self.weights > 0.0], side="right") - 1
        return deviations[run] * self._decay(rate, edges[run])

    def _basis(self, rates: FloatArray) -> FloatArray:
        """Columns: offset, gain, response of each exponential, its free initial state."""
        weights = self.weights[self.weights > 0.0]
        level = self.wave.level[self.bins[self.weights > 0.0]]
        columns = [np.ones_like(level), level]
        for rate in rates:
            # Deviation from the held level, at the sample instant and in the mean over the sample.
            clock_decay = np.expm1(-rate * self.period_s / self.mean_samples)
            mean = np.expm1(-rate * self.period_s) / (self.mean_samples * clock_decay)
            columns.append(level + self._deviation(rate) * mean * np.exp(rate * self.delay_s))
        columns += [self._decay(rate) for rate in rates]
        return np.column_stack(columns) * weights[:, None]

    def _fit(self, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        check_cancelled()
        basis = self._basis(rates)
        coefficients: FloatArray = np.linalg.lstsq(
            basis, self.displacement, rcond=1e-12)[0].astype(float)
        gains = slice(2, 2 + rates.size)
        if coefficients[gains].min(initial=0.0) < 0.0:
            # A rate slower than the record may appear in the initial state only, without a gain.
            free = np.delete(basis, gains, axis=1)
            span = np.linalg.qr(free)[0]
            positive = nonnegative_least_squares(
                without_span(basis[:, gains], span), without_span(self.displacement, span))[0]
            others = np.linalg.lstsq(
                free, self.displacement - basis[:, gains] @ positive, rcond=1e-12)[0]
            coefficients = np.concatenate([others[:2], positive, others[2:]])
        return coefficients, self.displacement - basis @ coefficients

    def creep(
        self, rates: FloatArray,
    ) -> tuple[CreepDynamics, dict[str, tuple[float, ...]]]:
        """Model with those rates that have a gain, and its standard deviations.

        With creep over many decades, the fastest rate stands for all that the rows do not show. It
        is not part of the model, but without it the others would be too fast.
        """
        coefficients, residual = self._fit(rates)
        gains = coefficients[2 : 2 + rates.size] / coefficients[1]
        has_gain = gains > 0.0
        if not has_gain.any():
            return CreepDynamics(), {"poles_rad_per_s": (), "zeros_rad_per_s": ()}
        basis = np.delete(self._basis(rates), 2 + np.flatnonzero(~has_gain), axis=1)
        by_rate = np.empty((residual.size, rates.size))
        for i, rate in enumerate(rates):
            step = 1e-5 * rate * np.eye(rates.size)[i]
            difference = self._basis(rates + step) - self._basis(rates - step)
            by_rate[:, i] = difference @ coefficients / (2e-5 * rate)
        rates, gains, by_rate = rates[has_gain], gains[has_gain], by_rate[:, has_gain]
        covariance = parameter_covariance(np.column_stack([by_rate, basis]), residual)
        # Of the coefficients, only the gains relative to the immediate one are physical.
        relative = np.zeros((2 * rates.size, covariance.shape[0]))
        relative[: rates.size, : rates.size] = np.eye(rates.size)
        relative[rates.size :, rates.size + 1] = -gains / coefficients[1]
        relative[rates.size :, rates.size + 2 : 2 * rates.size + 2] = (
            np.eye(rates.size) / coefficients[1]
        )
        return creep_of_partial_fractions(
            rates, gains, propagated(relative, covariance), FAST * self.fastest)

    def power_law(self) -> tuple[FloatArray, FloatArray, OrderTrial] | None:
        """Fit a power law; None if the record shows no creep in the direction of the steps.

        Return its point, the covariance of its level and its exponent, (2, 2), and the trial.
        """
        rates = rates_of_law(self.bounds)
        above = rates - rates.mean()
        basis, count = self._basis(np.exp(rates)), rates.size
        others, of_rates = np.delete(basis, np.s_[2 : 2 + count], axis=1), basis[:, 2 : 2 + count]

        def columns(exponent: float) -> FloatArray:
            return np.column_stack([of_rates @ np.exp(exponent * above), others])

        def fit(exponent: float) -> tuple[FloatArray, FloatArray]:
            check_cancelled()
            made = columns(exponent)
            coefficients: FloatArray = np.linalg.lstsq(
                made, self.displacement, rcond=1e-12)[0].astype(float)
            return coefficients, self.displacement - made @ coefficients

        solution = least_squares(lambda each: fit(each[0])[1], [0.0], bounds=(-1.0, 1.0))
        exponent = float(solution.x[0])
        coefficients, residual = fit(exponent)
        size, gain = coefficients[0], coefficients[2]
        if size <= 0.0 or gain <= 0.0:
            return None
        bent = size * (of_rates @ (above * np.exp(exponent * above)))
        covariance = parameter_covariance(np.column_stack([bent, columns(exponent)]), residual)
        relative = np.zeros((2, covariance.shape[0]))
        relative[0, [1, 3]] = 1.0 / size, -1.0 / gain
        relative[1, 0] = 1.0
        gains = np.log(size / gain) + exponent * above
        return (np.concatenate([rates, gains]), propagated(relative, covariance),
                order_trial(POWER_LAW, residual, 4 + count, signal=self.displacement))

    def first_run_off_um(self, creep: CreepDynamics) -> float:
        """Level before the first step minus that of later ones; 0 if they may be equal.

        It compares fits at given rates, one of which has a separate level before the first step.
        The creep responds to the difference too, which adds decays with free coefficients.
        """
        rates = np.asarray(creep.poles_rad_per_s)
        kept = self.weights > 0.0
        first = (self.bins[kept] < self.wave.steps[0]) * self.weights[kept]
        of_first = np.column_stack([first, *(first * self._decay(rate) for rate in rates)])
        basis = self._basis(rates)
        own = np.column_stack([basis, of_first])
        coefficients, _, rank, _ = np.linalg.lstsq(own, self.displacement, rcond=1e-12)
        apart = np.sum((self.displacement - own @ coefficients) ** 2)
        together = np.sum(self._fit(rates)[1] ** 2)
        rows = self.displacement.size
        gain = rows * np.log(together / max(apart, np.finfo(float).tiny))
        free = rank - np.linalg.matrix_rank(basis)
        return float(coefficients[basis.shape[1]]) if gain > free * np.log(rows) else 0.0

    def trial(self, rates: FloatArray) -> OrderTrial:
        """Rate a fit with these rates."""
        residual = self._fit(rates)[1]
        return order_trial(rates.size, residual, 2 + 3 * rates.size, signal=self.displacement)

    def best_further_rate(self, rates: FloatArray) -> float:
        """Rate that explains most when added to the others."""
        candidates = np.exp(np.linspace(self.bounds[0], self.bounds[1], 26)[1:-1])
        errors = [np.sum(self._fit(np.append(rates, rate))[1] ** 2) for rate in candidates]
        return candidates[np.argmin(errors)]

    def refine(self, rates: FloatArray) -> FloatArray:
        """Rates of least output error, with all linear coefficients projected out."""
        start = np.clip(np.log(rates), *(self.bounds + [1e-6, -1e-6]))
        solution = least_squares(
            lambda log_rates: self._fit(np.exp(log_rates))[1], start,
            bounds=tuple(self.bounds), xtol=1e-10, ftol=1e-12, gtol=1e-12, x_scale=1.0,
            max_nfev=60,
        )
        return np.exp(solution.x)
