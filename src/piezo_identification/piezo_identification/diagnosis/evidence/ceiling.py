# SPDX-License-Identifier: BSD-3-Clause
"""The part of the residual that any learner could predict, whatever its cause.

A learner without knowledge of stages is trained on the residual of the named effects. The part of
the held-out stretches that it predicts has a repeatable cause; the rest is regarded as random.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from sklearn.base import RegressorMixin
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler
from threadpoolctl import threadpool_limits

from piezo_common.arrays import FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.diagnosis.comparison.criteria import CRITERIA, significance
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects.backlash import Backlash


@dataclass(frozen=True)
class CeilingSettings:
    """Inputs and settings of the learner."""

    most_rows: int = 6_000
    """Largest number of samples for training and testing."""
    near_lags: int = 12
    """Number of past samples that are all used; further back, distances double."""
    furthest_share: float = 0.125
    """Largest lag, relative to the length of the recording."""
    low_passes: int = 5
    """Number of low-pass filters, with time constants from a few samples to a quarter of the
    recording."""
    play_widths: tuple[float, ...] = (0.03, 0.1, 0.2, 0.4, 0.7)
    """Widths of play operators, relative to the voltage range: the memory of a hysteresis."""
    folds: int = 4
    """Number of folds of the stretches for choosing the penalty of the ridge regression."""
    trees: int = 80
    leaves: int = 15
    samples_per_leaf: int = 40
    """Settings of the boosted trees."""


SETTINGS = CeilingSettings()


@dataclass(frozen=True)
class Ceiling:
    """Residual on held-out stretches, and the part of it that can be predicted.

    The squares of `predictable_um` and `random_um` add up to that of `left_um`.
    """

    left_um: float
    """RMS residual of the model with its effects."""
    predictable_um: float
    """RMS of the part that a learner predicts from voltage, displacement and their past."""
    from_voltage_um: float
    """The same from the voltage and its past alone."""
    random_um: float
    """RMS of the part that it cannot predict."""
    noise_um: float
    """RMS of the sensor noise in these samples."""

    def sentence(self) -> str:
        """Describe the repeatable and the random part of the residual."""
        rms, predicted, voltage, other = (
            f"{1e3 * value:.3g} nm" for value in (self.left_um, self.predictable_um,
                                                  self.from_voltage_um, self.random_um))
        if self.predictable_um == 0.0:
            return (f"No learner predicts any of the residual of {rms} on held-out stretches: it "
                    "is random, or has a cause that voltage and displacement do not show.")
        return (f"Of the residual of {rms} on held-out stretches a learner predicts {predicted} "
                f"from voltage, displacement and their past ({voltage} from the voltage alone): "
                f"this part repeats and has no name yet. {other} are random.")


def ceiling(regression: Regression, fit: Fit) -> Ceiling:
    """Return how much of the residual of a fit a learner without knowledge of effects predicts.

    Ridge regression, followed by gradient-boosted trees, is trained on the stretches that fits may
    use, and predicts the held-out ones. A prediction that is not significant counts as none.
    """
    held_out = regression.validation
    noise_um = regression.dataset.of_each(regression.noise.noise_um)[held_out]

    def square_um2(residual: FloatArray) -> float:
        return float(np.mean((residual * regression.tolerance_um)[held_out] ** 2))

    whole = square_um2(fit.residual)

    def predicted_um2(features: FloatArray) -> float:
        # With many threads, the trees would wait for each other while all cores are busy. This
        # limit applies to the thread that sets it.
        with threadpool_limits(1, user_api="openmp"):
            return max(0.0, whole - square_um2(_unpredicted(regression, fit, features)))

    # The limit for linear algebra applies to the process, so it is not set by each thread.
    with threadpool_limits(1, user_api="blas"):
        from_voltage, from_all = side_by_side(predicted_um2, _features(regression, fit))
    predictable = max(from_voltage, from_all)
    return Ceiling(*(float(np.sqrt(square)) for square in (
        whole, predictable, from_voltage, whole - predictable, np.mean(noise_um**2))))


def _features(regression: Regression, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return the inputs of the learner at each row: from the voltage, and from all, (r, n)."""
    dataset = regression.dataset
    lags = _lags(min(part.time_s.size for part in dataset.simulated))
    of_voltage, of_past = [], []
    for index, (part, rows) in enumerate(zip(dataset.simulated, dataset.rows, strict=True)):
        of_voltage.append(np.column_stack(
            [*_of_voltage(part.voltage_v, part.simulate(fit.effects), rows, lags)]))
        residual = residual_um(dataset, index, fit.effects, regression.noise)
        residual = np.where(regression.noise.outliers[index], 0.0, residual)
        of_past.append(np.column_stack([_before(residual, rows, lag) for lag in lags]))
    alone = np.vstack(of_voltage)
    return alone, np.hstack([alone, np.vstack(of_past)])


def _of_voltage(voltage_v: FloatArray, simulated_um: FloatArray,
                rows: NDArray[np.intp], lags: Sequence[int]) -> Iterator[FloatArray]:
    """Yield signals derived from the voltage, including the displacement of the model."""
    yield voltage_v[rows]
    yield simulated_um[rows]
    slowest = simulated_um.size / 4.0
    for samples in np.geomspace(min(4.0, slowest), slowest, SETTINGS.low_passes):
        kept = float(np.exp(-1.0 / samples))
        slow = lfilter([1.0 - kept], [1.0, -kept], simulated_um - simulated_um[0])
        yield (simulated_um - simulated_um[0] - slow)[rows]
    span = float(np.ptp(voltage_v))
    for width in SETTINGS.play_widths:
        yield Backlash(width * span).apply(voltage_v, 1.0)[rows]
    for lag in lags:
        for signal in (voltage_v, simulated_um):
            yield signal[rows] - _before(signal, rows, lag)


def _lags(samples: int) -> list[int]:
    """Return the lags in samples: all of the nearest, then fewer."""
    lags = list(range(1, SETTINGS.near_lags + 1))
    while 2 * lags[-1] <= SETTINGS.furthest_share * samples:
        lags.append(2 * lags[-1])
    return lags


def _before(signal: FloatArray, rows: NDArray[np.intp], lag: int) -> FloatArray:
    """Return a signal some samples before the rows, extended by its first value."""
    return signal[np.maximum(rows - lag, 0)]


def _unpredicted(regression: Regression, fit: Fit, features: FloatArray) -> FloatArray:
    """Return the residual of a fit without the part a learner predicts, in tolerances, (r,)."""
    rows = np.flatnonzero(regression.estimation)
    rows = rows[:: max(1, rows.size // SETTINGS.most_rows)]
    given = features[rows], fit.residual[rows], regression.dataset.stretch[rows]
    learners = _trained(*given)[: _how_many(*given)]
    residual = fit.residual.copy()
    held_out = regression.validation
    residual[held_out] -= _sum_of(learners, features[held_out])
    is_sure = significance(regression, fit, replace(fit, residual=residual)) > CRITERIA.significant
    return residual if is_sure else fit.residual


def _how_many(features: FloatArray, residual: FloatArray, stretch: NDArray[np.intp]) -> int:
    """Return the number of learners that predicts other data best."""
    half = stretch // SPLIT.held_out % 2 == 0
    squares = np.zeros(len(LEARNERS) + 1)
    for seen in (half, ~half):
        learners = _trained(features[seen], residual[seen], stretch[seen])
        for count in range(squares.size):
            error = residual[~seen] - _sum_of(learners[:count], features[~seen])
            squares[count] += error @ error
    return int(np.argmin(squares))


def _trained(features: FloatArray, residual: FloatArray,
             stretch: NDArray[np.intp]) -> list[RegressorMixin]:
    """Return the learners, each trained on the residual of those before it."""
    learners: list[RegressorMixin] = []
    for learner in LEARNERS:
        target = residual - _sum_of(learners, features)
        learners.append(learner(features, stretch).fit(features, target))
    return learners


def _linear(features: FloatArray, stretch: NDArray[np.intp]) -> RegressorMixin:
    # Neighbouring samples are correlated: the penalty is chosen on stretches that were not fitted.
    folds = list(GroupKFold(SETTINGS.folds).split(features, groups=stretch))
    # Inputs outside the training range are clipped, because a line would extrapolate without bound.
    return make_pipeline(MinMaxScaler(clip=True),
                         RidgeCV(alphas=np.logspace(-5.0, 4.0, 10), cv=folds))


def _trees(features: FloatArray, stretch: NDArray[np.intp]) -> RegressorMixin:
    del features, stretch
    return HistGradientBoostingRegressor(
        max_iter=SETTINGS.trees, max_leaf_nodes=SETTINGS.leaves,
        min_samples_leaf=SETTINGS.samples_per_leaf, early_stopping=False, random_state=0)


LEARNERS = (_linear, _trees)
"""Functions that make a learner; the second is trained on the residual of the first."""


def _sum_of(learners: Sequence[RegressorMixin], features: FloatArray) -> FloatArray:
    return sum((learner.predict(features) for learner in learners), np.zeros(len(features)))
