# SPDX-License-Identifier: BSD-3-Clause
"""Creep from any slow recordings, by making the displacement depend on the voltage only.

The inverse of the right creep yields the output of the hysteresis, which depends on the extremes of
the voltage and not on time: a regression on the Everett function (4.11). The creep is therefore the
one whose inverse this regression explains best. Any waveform is suitable: steps, trapezoids,
staircases and loops. The inverse commutes with the fast dynamics, so that only the samples after a
jump need to be omitted.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigh, qr
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.creep_removal import inverse_of_creep
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.segments import (
    Recordings,
    played_segments,
    voltage_range_v,
)
from piezo_identification.conditioning.waveforms import (
    jumps_of,
    longest_run,
    samples_per_mean,
)
from piezo_identification.estimators.creep.power_law import (
    POWER_LAW,
    continued,
    creep_of_point,
    end_of_law_rad_per_s,
    of_level_and_exponent,
    rates_of_law,
)
from piezo_identification.estimators.creep.square_wave_creep import (
    BINS_PER_DECADE,
    MORE_PAIRS,
    MOST_PAIRS,
    SHARE_OF_CREEP,
    CreepNotShown,
    left_out_s,
)
from piezo_identification.estimators.estimate import (
    DECISIVE,
    ROWS_OF_DECAY,
    Estimate,
    OrderTrial,
    creep_of_partial_fractions,
    independent_share,
    parameter_covariance,
)
from piezo_identification.estimators.hysteresis.everett_regression import (
    density_operator,
    everett_regression,
)
from piezo_identification.estimators.hysteresis.penalties import (
    curvature_operator,
    reversible_differences,
)
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

CELLS = 32
"""Number of cells along each threshold: the hysteresis only needs to be separated from the
creep."""

CURVATURE = 1e-11
"""Weight of the density's curvature, as in the thesis; it only matters where there are no
samples."""

MOST_BINS = 2000
"""Largest number of rows of the regression; longer recordings are averaged over neighbours."""

GAINS = (1e-4, 1.0)
"""Range of the gain of a creep exponential relative to the immediate gain."""

INDEPENDENT = 1e-7
"""Share of a column independent of the others below which it counts as dependent."""

CANDIDATES = 12
"""Number of rates tried for each further exponential."""

LARGEST_EXPONENT = 1.0
"""Largest exponent of a power law, of either sign: that of a motion in proportion to time."""

FIRST_GAINS = (0.01, 0.05)
"""Initial gains tried with each rate."""

STARTS = 2
"""Number of further rates tried as starts until the result can be creep."""

NUISANCES = (("drift",), ("first rise",), ("drift", "first rise"))
"""Signals that may be fitted in addition, with very strong evidence: sensor drift, and the
remanence of a first rise."""



def estimate_slow_creep(
    recordings: Recordings, dynamics: ElectricVibrationDynamics | None = None,
    pair_count: int | None = None, highest_rad_per_s: float = 0.0,
) -> Estimate:
    """Estimate the creep dynamics (4.4) from recordings of any slow voltage.

    The creep is either a few free exponentials, or a power law, which is continued to the modes.

    Hysteresis, offset and initial creep are fitted together with it. If the data show them, so are
    a drift proportional to time and the remanence of the first rise of a stage that was never
    cycled. Each recording, and each stretch after a gap, starts with an unknown past.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics, optional
        Known dynamics, whose ringing after each jump is omitted.
    pair_count : int, optional
        Number of pole and zero pairs; by default as many as the Bayesian information criterion
        justifies.
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
        If no samples remain after omitting those that follow jumps, or the data do not show the
        requested number of pairs.
    """
    parts = played_segments(recordings)
    settling_s = left_out_s(dynamics, step_s=max(
        longest_run(np.asarray(part.voltage_v, dtype=float)) * part.sample_period_s
        for part in parts))
    problem = _Problem(parts, settling_s)
    found = _search(problem, pair_count)
    residual = problem.residual(found.point)

    def gain(larger: _Problem) -> float:
        residual_then = larger.residual(found.point)
        return problem.gain_of(
            residual, residual_then, larger.width - problem.width, larger.share(residual_then))

    tried = [problem.with_nuisances(each) for each in NUISANCES]
    gains = [gain(each) for each in tried]
    if max(gains) > DECISIVE:
        problem = tried[int(np.argmax(gains))]
        found = _search(problem, pair_count)
    if pair_count is not None and found.trials[-1].refusal:
        raise CreepNotShown(
            f"{parts[0].path} does not show {pair_count} pairs of creep poles and zeros "
            f"({found.trials[-1].refusal}): ask for fewer, or record longer")
    model, deviations = problem.creep(found, end_of_law_rad_per_s(dynamics, highest_rad_per_s))
    return Estimate(model, deviations, found.order, tuple(found.trials), pair_count is not None)


@dataclass(frozen=True)
class _Found:
    """The chosen creep, and all orders that were tried."""

    order: int | str
    point: FloatArray
    free: FloatArray
    """Change of the point with each free number, (P, numbers)."""
    trials: list[OrderTrial]


def _search(problem: "_Problem", pair_count: int | None) -> _Found:
    """Add exponentials one by one; choose them or a power law by the information."""
    found = _free_exponentials(problem, pair_count)
    return found if pair_count is not None else _or_power_law(problem, found)


def _free_exponentials(problem: "_Problem", pair_count: int | None) -> _Found:
    """Add exponentials one by one, each from the best of several rates."""
    point = best = np.empty(0)
    residual = problem.residual(point)
    trials = [problem.trial(0, 0, residual, 0.0)]
    with while_time_lasts(MORE_PAIRS, 1.0 if pair_count else SHARE_OF_CREEP):
        for _ in range(MOST_PAIRS if pair_count is None else pair_count):
            for start in problem.starts(point):
                trial_point = problem.refine(start)
                if not problem.refusal(trial_point):
                    break
            residual_then = problem.residual(trial_point)
            gain = problem.gain_of(residual, residual_then, 3, problem.share(residual_then))
            pairs, refusal = trial_point.size // 2, problem.refusal(trial_point)
            trials.append(problem.trial(
                pairs, 3 * pairs, residual_then, trials[-1].information - gain, refusal))
            if pair_count is None and (refusal or gain <= 0.0):
                break
            point = best = trial_point
            residual = residual_then
    return _Found(best.size // 2, best, np.eye(best.size), trials)


def _or_power_law(problem: "_Problem", found: _Found) -> _Found:
    """Return free exponentials, or creep with a power law if that has less information."""
    point, free = problem.power_law()
    residual = problem.residual(point)
    # Each rate has a free initial state.
    numbers = free.shape[1] + point.size // 2
    chosen = next(trial for trial in found.trials if trial.order == found.order)
    gain = problem.gain_of(problem.residual(found.point), residual, numbers - chosen.parameters,
                           problem.share(residual))
    trial = problem.trial(POWER_LAW, numbers, residual, chosen.information - gain,
                          problem.refusal(point))
    trials = [*found.trials, trial]
    if gain > 0.0 and not trial.refusal:
        return _Found(POWER_LAW, point, free, trials)
    return replace(found, trials=trials)


class _Problem:
    """Rows of all recordings; a point contains logarithms of rates, then of gains."""

    def __init__(self, parts: Sequence[Recording], settling_s: float) -> None:
        lowest_v, highest_v = voltage_range_v(parts)
        levels_v = np.linspace(lowest_v, highest_v, CELLS + 1)
        self._parts = [_Part(part, levels_v, settling_s, MOST_BINS // len(parts)) for part in parts]
        self._explain_by(self._hysteresis_and_offsets())
        longest_s = max(part.time_s[-1] for part in parts)
        shortest_s = max(ROWS_OF_DECAY * min(part.sample_period_s for part in parts),
                         settling_s / 3.0)
        if self.rows < 20 or 0.3 / longest_s >= 0.5 / shortest_s:
            raise ValueError(
                f"{parts[0].path} has too few samples apart from the {settling_s:.3g} s after each "
                "jump, which are too fast to show creep: give the recording of a creep experiment")
        self.rates = np.log([0.3 / longest_s, 1.0 / shortest_s])
        self.gains = np.log(GAINS)

    def with_nuisances(self, names: Sequence[str]) -> "_Problem":
        """Return the problem with further signals of each recording."""
        added = block_diag(*(part.nuisances(names) for part in self._parts))
        scale = np.linalg.norm(added, axis=0)
        scale[scale == 0.0] = 1.0
        kept = self._kept
        normal = np.zeros((kept.shape[0], added.shape[1]))
        normal[: added.shape[0]] = added / scale
        for _ in range(2):  # once would leave rounding errors of what is nearly dependent
            normal -= kept @ (kept.T @ normal)
        orthogonal, triangle, _ = qr(normal, mode="economic", pivoting=True)
        independent = np.abs(np.diag(triangle)) > INDEPENDENT
        larger = copy(self)
        larger._explain_by(np.hstack([kept, orthogonal[:, independent]]))
        return larger

    def _hysteresis_and_offsets(self) -> FloatArray:
        """Return orthonormal directions of hysteresis and offsets, in the bins and the penalties.

        Smooth directions have no penalty, so that they are explained fully, and rough ones in part.
        """
        offsets = block_diag(*(part.offsets for part in self._parts))
        width = offsets.shape[1]
        columns = np.hstack([np.vstack([part.everett for part in self._parts]), offsets])
        density = density_operator(CELLS)
        curvature = CELLS**3 * (curvature_operator(CELLS) @ density)
        bend = CELLS**2.5 * reversible_differences(CELLS, 2)
        rough = np.vstack([curvature.toarray(), bend.toarray()]) * np.sqrt(
            CURVATURE * columns.shape[0])
        padded = np.hstack([rough, np.zeros((rough.shape[0], width))])
        scale = np.linalg.norm(np.vstack([columns, padded]), axis=0)
        scale[scale == 0.0] = 1.0
        normal = np.vstack([columns, padded]) / scale
        orthogonal, triangle, _ = qr(normal, mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        kept: FloatArray = orthogonal[:, sizes > INDEPENDENT * sizes[0]]
        return kept

    def _explain_by(self, kept: FloatArray) -> None:
        """Set what orthonormal directions in the bins and the penalties explain.

        Of bins x they leave x - S S' x, with S the span: as much as the residual of regression and
        penalties, without the rows of the penalties.
        """
        count = sum(part.everett.shape[0] for part in self._parts)
        bins, penalties = kept[:count], kept[count:]
        self._kept, self.width = kept, kept.shape[1]
        # Number of rows minus the degrees of freedom of the hysteresis, which the penalties reduce.
        self.rows = count - round(float(np.sum(bins**2)))
        # Where the penalties leave the share s, 1 - s is explained. In the bins, a direction is as
        # long as the root of 1 - s^2, by which it need not be divided: that may be near zero.
        _, mixed = eigh(penalties.T @ penalties)
        shares = np.linalg.norm(penalties @ mixed, axis=0)
        self._span = bins @ (mixed / np.sqrt(1.0 + shares))

    def residual(self, point: FloatArray) -> FloatArray:
        """Return the residual of hysteresis, offsets and initial creep, with the creep removed."""
        check_cancelled()
        rates, gains = np.exp(np.split(point, 2))
        target = np.concatenate([part.without_creep(rates, gains) for part in self._parts])
        zeros = np.asarray(creep_of_partial_fractions(rates, gains)[0].zeros_rad_per_s)
        both = np.column_stack([target, block_diag(*(part.decays(zeros) for part in self._parts))])
        both = both - self._span @ (self._span.T @ both)
        residual: FloatArray = both[:, 0]
        if both.shape[1] > 1:
            residual = residual - both[:, 1:] @ np.linalg.lstsq(
                both[:, 1:], residual, rcond=1e-9)[0]
        return residual * self._noise_raised(rates, gains)

    def share(self, residual: FloatArray) -> float:
        """Return the share of independent rows in a residual."""
        return independent_share(residual - self._span @ (self._span.T @ residual))

    def _noise_raised(self, rates: FloatArray, gains: FloatArray) -> float:
        """Return the factor that compensates for noise reduced by the inverse of the creep.

        Without it, creep faster than the rows would explain any noise. It is the geometric mean
        over the bins, as in the likelihood of the displacements.
        """
        faster = [np.log1p(-np.expm1(-np.outer(part.durations_s, rates)) @ gains)
                  for part in self._parts]
        return float(np.exp(np.concatenate(faster).mean()))

    def with_further(self, point: FloatArray) -> list[FloatArray]:
        """Return the points with one more exponential, for all tried rates, best first."""
        rates, gains = np.split(point, 2)
        starts = []
        for rate in np.linspace(self.rates[0], self.rates[1], CANDIDATES + 2)[1:-1]:
            trials = [np.concatenate([rates, [rate], gains, [np.log(gain)]])
                      for gain in FIRST_GAINS]
            costs = [float(np.sum(self.residual(trial) ** 2)) for trial in trials]
            starts.append((min(costs), trials[int(np.argmin(costs))]))
        return [start for _, start in sorted(starts, key=lambda pair: pair[0])]

    def starts(self, point: FloatArray) -> list[FloatArray]:
        """Return starts with one more exponential, including one with evenly spaced rates."""
        count = point.size // 2 + 1
        spread = np.append(
            np.linspace(self.rates[0], self.rates[1], count + 2)[1:-1],
            np.full(count, np.log(FIRST_GAINS[-1])))
        further = self.with_further(point)
        return [further[0], spread, *further[1:STARTS]]

    def refine(self, point: FloatArray) -> FloatArray:
        """Rates and gains with the smallest error."""
        pairs = point.size // 2
        low, high = (np.repeat([self.rates[end], self.gains[end]], pairs) for end in (0, 1))
        solution = least_squares(
            self.residual, np.clip(point, low + 1e-6, high - 1e-6), bounds=(low, high),
            xtol=1e-7, ftol=1e-9, gtol=1e-12, max_nfev=30)
        result: FloatArray = solution.x
        return result

    def refusal(self, point: FloatArray) -> str:
        """Return why these exponentials cannot be creep; empty if they can."""
        rates, gains = np.split(point, 2)
        if np.any(gains <= self.gains[0] + 0.01) or np.any(gains >= self.gains[1] - 0.01):
            return "a gain is not positive, or larger than the immediate one"
        if np.any(rates >= self.rates[1] - 0.01):
            return "a rate is too fast for the rows"
        return ""

    def gain_of(self, before: FloatArray, after: FloatArray, parameters: int,
                share: float) -> float:
        """Decrease of the Bayesian information criterion, from the share of independent rows.

        Errors of the hysteresis grid are correlated in neighbouring rows, which then count less.
        """
        rows = max(self.rows * share, 10.0)
        return float(
            rows * np.log(np.sum(before**2) / np.sum(after**2)) - parameters * np.log(rows))

    def power_law(self) -> tuple[FloatArray, FloatArray]:
        """Return the point of the best power law, and its change with level and exponent."""
        rates = rates_of_law(self.rates)
        fixed = np.concatenate([rates, np.zeros_like(rates)])
        free = of_level_and_exponent(rates, rates.mean())
        solution = least_squares(
            lambda numbers: self.residual(fixed + free @ numbers), [np.log(FIRST_GAINS[0]), 0.0],
            bounds=list(zip(self.gains, (-LARGEST_EXPONENT, LARGEST_EXPONENT), strict=True)),
            xtol=1e-7, ftol=1e-9, gtol=1e-12, max_nfev=30)
        return fixed + free @ solution.x, free

    def trial(self, order: int | str, numbers: int, residual: FloatArray, information: float,
              refusal: str = "") -> OrderTrial:
        """Describe a fit, with its information relative to no creep."""
        rms = float(np.sqrt(np.sum(residual**2) / self.rows))
        return OrderTrial(order, numbers, rms, information, refusal)

    def creep(self, found: _Found,
              end_rad_per_s: float) -> tuple[CreepDynamics, dict[str, object]]:
        """Model of the chosen creep, and its standard deviations.

        A power law is continued to a rate that the rows do not show.
        """
        point, free = found.point, found.free
        if not point.size:
            return CreepDynamics(), {"poles_rad_per_s": (), "zeros_rad_per_s": ()}
        residual = self.residual(point)
        jacobian = np.column_stack([
            (self.residual(point + 1e-4 * each) - self.residual(point - 1e-4 * each)) / 2e-4
            for each in free.T])
        covariance = parameter_covariance(
            jacobian, residual, residual.size - self.rows + free.shape[1] + point.size // 2)
        if found.order == POWER_LAW:
            point, free = continued(point, end_rad_per_s)
        return creep_of_point(point, free, covariance)


class _Part:
    """A stretch without gaps, with similar samples combined into bins."""

    def __init__(self, part: Recording, levels_v: FloatArray, settling_s: float,
                 most_bins: int) -> None:
        self._period_s = part.sample_period_s
        self._mean_samples = samples_per_mean(part)
        # An instantaneous displacement is measured before the voltage of its row acts.
        shift = 1 if self._mean_samples == 1 else 0
        voltage_v = np.asarray(part.voltage_v[: part.voltage_v.size - shift], dtype=float)
        self._displacement_um = np.asarray(part.displacement_um[shift:], dtype=float)
        self._time_s = np.arange(voltage_v.size) * self._period_s
        regression = everett_regression(voltage_v, levels_v)
        skipped = int(np.ceil(settling_s / self._period_s))
        used = _used(voltage_v, float(levels_v[-1] - levels_v[0]), skipped)
        used &= (regression.history >= 0) & good_samples(part)[shift:]
        number = _bins(voltage_v, levels_v, used, regression.history, skipped, most_bins)
        samples = np.flatnonzero(used)
        _, place, counts = np.unique(number[used], return_inverse=True, return_counts=True)
        self._counts = counts.astype(float)
        self.durations_s = self._counts * self._period_s
        # Each bin is a run of samples.
        self._bin = np.full(self._time_s.size, -1)
        self._bin[samples] = place
        self._starts_s = self._time_s[samples[np.searchsorted(place, np.arange(counts.size))]]
        # Means over the bins, weighted to equal variance.
        self._gather = csr_array(
            (1.0 / np.sqrt(self._counts)[place], (place, samples)),
            shape=(self._counts.size, self._time_s.size))
        self.everett = np.asarray((self._gather @ regression.matrix).toarray())
        histories = np.unique(regression.history[used])
        self.offsets = self._columns(
            [(regression.history == each).astype(float) for each in histories])
        self._voltage_v, self._levels_v = voltage_v, levels_v

    def nuisances(self, names: Sequence[str]) -> FloatArray:
        """Return the columns of further signals."""
        signals = list[FloatArray]()
        if "drift" in names and self.offsets.size:
            signals.append(self._time_s / self._time_s[-1])
        if "first rise" in names:
            signals += _passed(self._voltage_v, self._levels_v)
        return self._columns(signals)

    def _columns(self, signals: Sequence[FloatArray]) -> FloatArray:
        return (self.means(np.column_stack(signals)) if signals
                else np.empty((self._counts.size, 0)))

    def means(self, signals: FloatArray) -> FloatArray:
        """Means over the bins, weighted to equal variance."""
        return np.asarray(self._gather @ signals)

    def without_creep(self, rates: FloatArray, gains: FloatArray) -> FloatArray:
        """Bins of the displacement filtered by the exact inverse of the creep for held input."""
        at_once, forgotten, weights = inverse_of_creep(
            rates, gains, self._period_s, _unanswered(rates, self._period_s, self._mean_samples))
        sums = _sums_of_rest(
            self._displacement_um, self._bin, self._counts.size, 1.0 - forgotten, weights)
        first_um = self._displacement_um[0] / (1.0 + gains.sum())
        return (sums / at_once + first_um * self._counts) / np.sqrt(self._counts)

    def decays(self, zeros: FloatArray) -> FloatArray:
        """Bins of the remaining earlier creep, shape (bins, zeros)."""
        counts = self._counts[:, None]
        sums = np.expm1(-zeros * self._period_s * counts) / np.expm1(-zeros * self._period_s)
        return np.exp(-np.outer(self._starts_s, zeros)) * sums / np.sqrt(counts)


@njit(cache=True, nogil=True)
def _sums_of_rest(signal: FloatArray, bins: NDArray[np.intp], count: int, kept: FloatArray,
                  weights: FloatArray) -> FloatArray:
    """Sum over each of `count` bins the change of a signal, minus weighted sums of its past.

    Signal and number of the bin of each sample, negative for none, are (N,). `kept`, (P,), is the
    fraction of each sum that is kept from one sample to the next, and `weights`, (P,), its weight.
    """
    sums, states = np.zeros(count), np.zeros(kept.size)
    for n in range(signal.size):
        moved = signal[n] - signal[0]
        rest = moved
        for k in range(kept.size):
            rest -= weights[k] * states[k]
            states[k] = kept[k] * states[k] + moved
        if bins[n] >= 0:
            sums[bins[n]] += rest
    return sums


def _passed(voltage_v: FloatArray, levels_v: FloatArray) -> list[FloatArray]:
    """For each level passed during the recording, return whether it has been passed, by sample."""
    highest_v = np.maximum.accumulate(voltage_v)
    return [(highest_v >= level_v).astype(float) for level_v in levels_v[1:]
            if highest_v[0] < level_v <= highest_v[-1]]


def _unanswered(rates: FloatArray, period_s: float, mean_samples: int) -> FloatArray:
    """Return the fraction of a step still missing in exponentials at the end of its row.

    For a displacement averaged over several clock samples, it is the mean over these.
    """
    if mean_samples == 1:
        return np.exp(-rates * period_s)
    return np.expm1(-rates * period_s) / (
        mean_samples * np.expm1(-rates * period_s / mean_samples))


def _used(voltage_v: FloatArray, range_v: float, skipped: int) -> NDArray[np.bool_]:
    """Mark samples except those right after a jump and the last one before it.

    The last one is excluded because a logger that reads late sees the response to the jump there.
    """
    jumps = jumps_of(voltage_v, range_v)
    since = np.arange(voltage_v.size)
    last = np.full(voltage_v.size, -skipped - 1)
    last[jumps] = jumps
    used = since - np.maximum.accumulate(last) >= skipped
    used[jumps - 1] = False
    return used


def _bins(
    voltage_v: FloatArray, levels_v: FloatArray, used: NDArray[np.bool_],
    history: NDArray[np.intp], skipped: int, most_bins: int,
) -> NDArray[np.intp]:
    """Return the bin of each sample: logarithmic in time during a hold, by cell while moving.

    Creep during a hold needs no finer resolution in logarithmic time.
    """
    cell_v = (levels_v[-1] - levels_v[0]) / CELLS
    way = np.abs(np.diff(voltage_v, prepend=voltage_v[0])) / cell_v
    moves = way > 1e-3 / max(1, skipped)
    moved = np.flatnonzero(moves)
    last = np.zeros(voltage_v.size, dtype=int)
    last[moved] = moved
    since = np.arange(voltage_v.size) - np.maximum.accumulate(last)
    held = np.floor(
        BINS_PER_DECADE * np.log10(np.maximum(since, 1) / max(skipped, 1)).clip(0.0))
    group = np.maximum(1, voltage_v.size // most_bins)
    changes = (np.diff(held, prepend=held[0]) != 0.0) | (np.diff(history, prepend=0) != 0)
    changes |= np.diff(used.astype(int), prepend=0) != 0
    changes |= moves & (np.arange(voltage_v.size) % group == 0)
    changes |= moves & ~np.append(False, moves[:-1])
    return np.cumsum(changes)
