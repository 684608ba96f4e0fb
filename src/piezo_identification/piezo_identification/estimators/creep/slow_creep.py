# SPDX-License-Identifier: BSD-3-Clause
"""Creep from any slow recordings: what makes of the displacement a memory of the voltage alone.

The inverse of the creep that is sought leaves the output of the hysteresis, which depends on the
extremes of the voltage and not on time: a regression on the Everett function (4.11). So the creep
is the one whose inverse this regression explains best. Steps, trapezoids, staircases and loops
are alike to it. The inverse commutes with the fast dynamics, so that what follows a jump need only
be left out.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import qr, svd
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.creep_removal import inverse_of_creep
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.segments import Recordings, played_segments
from piezo_identification.conditioning.waveforms import samples_per_mean
from piezo_identification.estimators.creep.square_wave_creep import (
    BINS_PER_DECADE,
    MORE_PAIRS,
    MOST_PAIRS,
    SHARE_OF_CREEP,
    CreepNotShown,
    left_out_s,
)
from piezo_identification.estimators.estimate import (
    ROWS_OF_DECAY,
    Estimate,
    OrderTrial,
    creep_of_partial_fractions,
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
"""Along each threshold: the hysteresis is only to be told apart from the creep."""

CURVATURE = 1e-11
"""Weight of the density's curvature, of the thesis' kind; it only decides what no sample shows."""

MOST_BINS = 2000
"""Rows of the regression; neighbouring samples of longer recordings are averaged."""

JUMP_SHARE = 0.02
"""A change within a sample by more than this part of the voltage's range is a jump."""

GAINS = (1e-4, 1.0)
"""Gain of a creep exponential over the immediate one, between which it is sought."""

INDEPENDENT = 1e-7
"""Share of a column that others do not make, below which it counts as made of them."""

HELD = 1e-8
"""Share of a direction that hysteresis and offsets make, below which they count as free of it."""

CANDIDATES = 12
"""Rates that are tried for each further exponential."""

FIRST_GAINS = (0.01, 0.05)
"""Fits begin with these gains of each rate that is tried."""

STARTS = 2
"""Further rates from which a fit may begin, until one is found that can be creep."""

NUISANCES = (("drift",), ("first rise",), ("drift", "first rise"))
"""What may be fitted beside: a drift of the sensor, and what a first rise leaves for good."""

NUISANCE_GAIN = 10.0
"""They are taken if the information criterion falls by more than this."""


def estimate_slow_creep(
    recordings: Recordings, dynamics: ElectricVibrationDynamics | None = None,
    pair_count: int | None = None,
) -> Estimate:
    """Estimate the creep dynamics (4.4) from recordings of any slow voltage.

    Hysteresis, offset and initial creep are fitted beside; so are, where the data show them, a
    drift in proportion to time and what the first rise of a stage that was never cycled leaves.
    Each recording, and each stretch after a gap, begins with an unknown past.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics, optional
        If known: their ringing after each jump is left out.
    pair_count : int, optional
        Number of pole and zero pairs; by default as many as the Bayesian information criterion
        justifies.

    Returns
    -------
    Estimate
        Its model is a `CreepDynamics`; its order counts pairs of pole and zero.

    Raises
    ------
    ValueError
        If nothing is left of the recordings beside what follows jumps, or the data do not show as
        many pairs.
    """
    parts = played_segments(recordings)
    settling_s = left_out_s(dynamics)
    problem = _Problem(parts, settling_s)
    point, trials = _search(problem, pair_count)
    residual = problem.residual(point)

    def gain(beside: _Problem) -> float:
        left = beside.residual(point)
        return problem.gain_of(
            residual, left, beside.width - problem.width, beside.alike(left))

    tried = [_Problem(parts, settling_s, each) for each in NUISANCES]
    gains = [gain(each) for each in tried]
    if max(gains) > NUISANCE_GAIN:
        problem = tried[int(np.argmax(gains))]
        point, trials = _search(problem, pair_count)
    if pair_count is not None and trials[-1].refusal:
        raise CreepNotShown(
            f"{parts[0].path} does not show {pair_count} pairs of creep poles and zeros "
            f"({trials[-1].refusal}): ask for fewer, or record longer")
    model, deviations = problem.creep(point)
    return Estimate(model, deviations, point.size // 2, tuple(trials), pair_count is not None)


def _search(
    problem: "_Problem", pair_count: int | None,
) -> tuple[FloatArray, list[OrderTrial]]:
    """Add exponentials one by one, each from the best of some rates."""
    point = best = np.empty(0)
    residual = problem.residual(point)
    trials = [problem.trial(point, residual, 0.0)]
    with while_time_lasts(MORE_PAIRS, 1.0 if pair_count else SHARE_OF_CREEP):
        for _ in range(MOST_PAIRS if pair_count is None else pair_count):
            for start in problem.starts(point):
                trial_point = problem.refine(start)
                if not problem.refusal(trial_point):
                    break
            left = problem.residual(trial_point)
            gain = problem.gain_of(residual, left, 3, problem.alike(left))
            trials.append(problem.trial(trial_point, left, trials[-1].information - gain))
            if pair_count is None and (trials[-1].refusal or gain <= 0.0):
                break
            point = best = trial_point
            residual = left
    return best, trials


class _Problem:
    """Rows of all recordings; a point is the logarithms of rates, then those of gains."""

    def __init__(self, parts: Sequence[Recording], settling_s: float,
                 nuisances: Sequence[str] = ()) -> None:
        lowest_v = min(part.voltage_v.min() for part in parts)
        highest_v = max(part.voltage_v.max() for part in parts)
        if lowest_v == highest_v:
            raise ValueError(
                f"the voltage of {parts[0].path} is {lowest_v:g} V throughout: give a recording "
                "in which it moves")
        levels_v = np.linspace(lowest_v, highest_v, CELLS + 1)
        self._parts = [
            _Part(part, levels_v, settling_s, MOST_BINS // len(parts), nuisances)
            for part in parts]
        self._span, self._left = self._explained_by_hysteresis()
        longest_s = max(part.time_s[-1] for part in parts)
        shortest_s = max(ROWS_OF_DECAY * min(part.sample_period_s for part in parts),
                         settling_s / 3.0)
        if self.rows < 20 or 0.3 / longest_s >= 0.5 / shortest_s:
            raise ValueError(
                f"{parts[0].path} leaves too little beside the {settling_s:.3g} s after each "
                "jump, too fast to show creep: give the recording of a creep experiment")
        self.rates = np.log([0.3 / longest_s, 1.0 / shortest_s])
        self.gains = np.log(GAINS)

    def _explained_by_hysteresis(self) -> tuple[FloatArray, FloatArray]:
        """Return orthonormal directions that hysteresis and offsets make, and how much they leave.

        They leave of what is smooth nothing, and of what is rough a part, for the penalties.
        """
        width = sum(part.offsets.shape[1] for part in self._parts)
        blocks, first = [], 0
        for part in self._parts:
            own = np.zeros((part.offsets.shape[0], width))
            own[:, first : first + part.offsets.shape[1]] = part.offsets
            blocks.append(np.hstack([part.everett, own]))
            first += part.offsets.shape[1]
        columns = np.vstack(blocks)
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
        count = columns.shape[0]
        self.width = kept.shape[1]
        # Rows less what the hysteresis takes of them, which the penalties make a fraction.
        self.rows = count - round(float(np.sum(kept[:count] ** 2)))
        # Hundreds of the values are zero: under some kernels divide and conquer does not converge.
        directions, made, mixed = svd(kept[:count], full_matrices=False, lapack_driver="gesvd")
        # Sines and cosines of the same angles: the penalties tell how little is left.
        left = np.linalg.norm(kept[count:] @ mixed.T, axis=0)
        return directions[:, made > HELD], left[made > HELD]

    def residual(self, point: FloatArray) -> FloatArray:
        """Return what hysteresis, offsets and initial creep leave where the creep is removed."""
        check_cancelled()
        rates, gains = np.exp(np.split(point, 2))
        target = np.concatenate([part.without_creep(rates, gains) for part in self._parts])
        zeros = np.asarray(creep_of_partial_fractions(rates, gains)[0].zeros_rad_per_s)
        own = [part.decays(zeros) for part in self._parts]
        both = np.zeros((target.size, 1 + zeros.size * len(own)))
        both[:, 0] = target
        first = 0
        for index, each in enumerate(own):
            column = 1 + index * zeros.size
            both[first : first + len(each), column : column + zeros.size] = each
            first += len(each)
        # As long as what regression and penalties leave, without the rows of the penalties.
        both = both - self._span @ ((1.0 - self._left)[:, None] * (self._span.T @ both))
        left: FloatArray = both[:, 0]
        if both.shape[1] > 1:
            left = left - both[:, 1:] @ np.linalg.lstsq(both[:, 1:], left, rcond=1e-9)[0]
        return left * self._noise_raised(rates, gains)

    def alike(self, residual: FloatArray) -> float:
        """Return how far neighbouring rows of a residual of this problem are alike, 0 to 1."""
        data = residual - self._span @ ((1.0 - self._left) * (self._span.T @ residual))
        return float(np.clip(data[1:] @ data[:-1] / (data @ data), 0.0, 0.98))

    def _noise_raised(self, rates: FloatArray, gains: FloatArray) -> float:
        """Return by how much noise is raised that the inverse of the creep has lowered.

        Without it, creep that is faster than the rows would explain any noise. It is the geometric
        mean over the bins, as in the likelihood of the displacements.
        """
        faster = [np.log1p(-np.expm1(-np.outer(part.durations_s, rates)) @ gains)
                  for part in self._parts]
        return float(np.exp(np.concatenate(faster).mean()))

    def with_further(self, point: FloatArray) -> list[FloatArray]:
        """Add an exponential: the points of all rates that are tried, the best first."""
        rates, gains = np.split(point, 2)
        starts = []
        for rate in np.linspace(self.rates[0], self.rates[1], CANDIDATES + 2)[1:-1]:
            trials = [np.concatenate([rates, [rate], gains, [np.log(gain)]])
                      for gain in FIRST_GAINS]
            costs = [float(np.sum(self.residual(trial) ** 2)) for trial in trials]
            starts.append((min(costs), trials[int(np.argmin(costs))]))
        return [start for _, start in sorted(starts, key=lambda pair: pair[0])]

    def starts(self, point: FloatArray) -> list[FloatArray]:
        """Points with one exponential more, and one of evenly spread rates between them."""
        count = point.size // 2 + 1
        spread = np.append(
            np.linspace(self.rates[0], self.rates[1], count + 2)[1:-1],
            np.full(count, np.log(FIRST_GAINS[-1])))
        further = self.with_further(point)
        return [further[0], spread, *further[1:STARTS]]

    def refine(self, point: FloatArray) -> FloatArray:
        """Rates and gains of least error."""
        pairs = point.size // 2
        low, high = (np.repeat([self.rates[end], self.gains[end]], pairs) for end in (0, 1))
        solution = least_squares(
            self.residual, np.clip(point, low + 1e-6, high - 1e-6), bounds=(low, high),
            xtol=1e-7, ftol=1e-9, gtol=1e-12, max_nfev=30)
        result: FloatArray = solution.x
        return result

    def refusal(self, point: FloatArray) -> str:
        """Why these exponentials cannot be creep; empty if they can."""
        rates, gains = np.split(point, 2)
        if np.any(gains <= self.gains[0] + 0.01) or np.any(gains >= self.gains[1] - 0.01):
            return "a gain is not positive, or larger than the immediate one"
        if np.any(rates >= self.rates[1] - 0.01):
            return "a rate is too fast for the rows"
        return ""

    def gain_of(self, before: FloatArray, after: FloatArray, parameters: int,
                alike: float) -> float:
        """Fall of the Bayesian information criterion, over rows that are independent.

        What the grid leaves of the hysteresis is alike in neighbouring rows, which then count less.
        """
        rows = max(self.rows * (1.0 - alike) / (1.0 + alike), 10.0)
        return float(
            rows * np.log(np.sum(before**2) / np.sum(after**2)) - parameters * np.log(rows))

    def trial(self, point: FloatArray, residual: FloatArray, information: float) -> OrderTrial:
        """Describe a fit, with its information relative to that of no creep."""
        pairs = point.size // 2
        rms = float(np.sqrt(np.sum(residual**2) / self.rows))
        return OrderTrial(pairs, 3 * pairs, rms, information, self.refusal(point))

    def creep(self, point: FloatArray) -> tuple[CreepDynamics, dict[str, object]]:
        """Model of a point, and its standard deviations."""
        rates, gains = np.exp(np.split(point, 2))
        if rates.size == 0:
            return CreepDynamics(), {"poles_rad_per_s": (), "zeros_rad_per_s": ()}
        residual = self.residual(point)
        steps = 1e-4 * np.eye(point.size)
        jacobian = np.column_stack([
            (self.residual(point + step) - self.residual(point - step)) / 2e-4 for step in steps])
        values = np.concatenate([rates, gains])
        covariance = parameter_covariance(
            jacobian / values, residual, residual.size - self.rows + 3 * rates.size)
        return creep_of_partial_fractions(rates, gains, covariance)


class _Part:
    """A stretch without gaps, in bins of the samples that are alike."""

    def __init__(self, part: Recording, levels_v: FloatArray, settling_s: float, most_bins: int,
                 nuisances: Sequence[str]) -> None:
        self._period_s = part.sample_period_s
        self._mean_samples = samples_per_mean(part)
        # A displacement at an instant is that before the voltage of its row acts.
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
        offsets = [(regression.history == each).astype(float) for each in histories]
        if "drift" in nuisances and offsets:
            offsets.append(self._time_s / self._time_s[-1])
        if "first rise" in nuisances:
            offsets += _passed(voltage_v, levels_v)
        self.offsets = self.means(np.column_stack(offsets)) if offsets else np.empty((0, 0))

    def means(self, signals: FloatArray) -> FloatArray:
        """Means over the bins, weighted to equal variance."""
        return np.asarray(self._gather @ signals)

    def without_creep(self, rates: FloatArray, gains: FloatArray) -> FloatArray:
        """Bins of the displacement passed through the exact inverse of the creep for held input."""
        at_once, forgotten, weights = inverse_of_creep(
            rates, gains, self._period_s, _unanswered(rates, self._period_s, self._mean_samples))
        sums = _sums_of_rest(
            self._displacement_um, self._bin, self._counts.size, 1.0 - forgotten, weights)
        first_um = self._displacement_um[0] / (1.0 + gains.sum())
        return (sums / at_once + first_um * self._counts) / np.sqrt(self._counts)

    def decays(self, zeros: FloatArray) -> FloatArray:
        """Bins of what is left of the creep from before, shape (bins, zeros)."""
        counts = self._counts[:, None]
        sums = np.expm1(-zeros * self._period_s * counts) / np.expm1(-zeros * self._period_s)
        return np.exp(-np.outer(self._starts_s, zeros)) * sums / np.sqrt(counts)


@njit(cache=True, nogil=True)
def _sums_of_rest(signal: FloatArray, bins: NDArray[np.intp], count: int, kept: FloatArray,
                  weights: FloatArray) -> FloatArray:
    """Sum over each bin how far a signal has moved, less weighted sums of where it was before.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    bins : ndarray of int, shape (N,)
        The bin of each sample; negative for none.
    count : int
        Bins.
    kept, weights : ndarray, shape (P,)
        Part of each sum that is kept from one sample to the next, and its weight.
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
    """Tell for each level that is passed while recorded, sample by sample, whether it has been."""
    highest_v = np.maximum.accumulate(voltage_v)
    return [(highest_v >= level_v).astype(float) for level_v in levels_v[1:]
            if highest_v[0] < level_v <= highest_v[-1]]


def _unanswered(rates: FloatArray, period_s: float, mean_samples: int) -> FloatArray:
    """Return the part of a step by which exponentials are behind at the end of its row.

    Of a displacement that is a mean over several clock samples, it is the mean over these.
    """
    if mean_samples == 1:
        return np.exp(-rates * period_s)
    return np.expm1(-rates * period_s) / (
        mean_samples * np.expm1(-rates * period_s / mean_samples))


def _used(voltage_v: FloatArray, range_v: float, skipped: int) -> NDArray[np.bool_]:
    """Mark the samples that are not just after a jump, nor the last before one.

    A logger that reads its rows late reads in the last one what the jump has done already.
    """
    jumps = np.flatnonzero(np.abs(np.diff(voltage_v, prepend=voltage_v[0])) > JUMP_SHARE * range_v)
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
    """Return the bin of each sample: logarithmic in the time of a hold, within a cell on the way.

    Creep after a hold began needs no finer view of logarithmic time.
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
