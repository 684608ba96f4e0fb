# SPDX-License-Identifier: BSD-3-Clause
"""The usual error of a model for a kind of motion, and its uncertainty.

The squared error is the power of the noise plus a fraction of the motion's power in each band. The
model file gives first values of these fractions; tracked motion improves them. The error of a kind
of motion differs from this prediction by a factor, and that of each of its blocks by another one.
Both factors are log-normal, with spreads pooled over all kinds (A. Gelman et al., Bayesian Data
Analysis, 2013, chapter 5). The uncertainty of a new kind is thus the spread between kinds, and that
of a known kind is the spread of its blocks.

The evidence that an error has grown since some time sums the Bayes factors of all times of change
and all factors of growth (Shiryaev 1963; Roberts 1966). Without a change, this sum grows by one per
block on average, whatever the distribution of the blocks. It therefore takes at least A blocks on
average to exceed a threshold A (M. Pollak, Annals of Statistics 15, 1987).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import gammaln

from piezo_common.arrays import FloatArray
from piezo_models.identified_model import IdentifiedModel

KINDS = 512
"""Most kinds of motion in memory; the one that was not met for longest is dropped first."""

BETWEEN, WITHIN = 0.5, 0.2
"""Prior spreads of the logarithm between kinds and between the blocks of a kind."""

BELIEVED_KINDS, BELIEVED_BLOCKS = 4.0, 3.0
"""Weights of the spreads: number of kinds that the priors count for, and number of blocks that the
pooled spread counts for in a kind."""

STATED_SPREAD = 0.7
"""Spread of the logarithm of an error stated in a model file: a factor of two."""

WANDER = 0.3
"""Spread of the logarithm that occurs without any change: about a third up or down."""

FURTHEST = 4.0
"""Largest deviation of a block, in scales; larger ones are clipped before learning."""

STEPS = 3
"""Gauss-Newton steps at each update; few suffice, as the fractions change little."""

FACTORS = np.geomspace(2.5, 250.0, 19)
"""Factors by which an error may have grown, all equally likely. An error that has doubled is nearer
to the smallest factor than to no growth."""

STRAY, STRAY_RANGE = 0.05, 10.0
"""Fraction of blocks with an error of any size, for example from a spike, and the range of the
logarithm of that error. They keep a single block from indicating a change."""


@dataclass(frozen=True)
class KnownError:
    """Prior knowledge of the error of a model."""

    part_of_motion: float = 3e-3
    """RMS of the error over that of the motion."""
    noise_um: float = 0.01
    """RMS noise of the sensor."""
    spread: float = 3.0
    """Standard deviation of the logarithms of both."""


def known_error(identified: IdentifiedModel) -> KnownError:
    """Return the error that a model file states.

    It is the error on unseen data or, without unseen data, on the data of the fit, together with
    the lowest noise of the recordings.
    """
    stated = list(_stated_percent(identified.errors)) or [
        part["error_percent"] for part in identified.adequacy.values()
        if part.get("error_percent")]
    noise_um = [part["noise_rms_um"] for part in identified.adequacy.values()
                if part.get("noise_rms_um")]
    if not stated:
        return KnownError()
    unknown = KnownError()
    return KnownError(float(np.max(stated)) / 100.0, min(noise_um, default=unknown.noise_um),
                      STATED_SPREAD)


def _stated_percent(errors: Mapping[str, Any]) -> Iterator[float]:
    """Yield the relative errors of the whole motion in a tree of errors."""
    for name, value in errors.items():
        if isinstance(value, Mapping):
            yield from _stated_percent(value)
        elif name == "e_y_percent" and value > 0.0:
            yield float(value)


@dataclass(eq=False)
class _Kind:
    """A kind of motion with count, mean and sum of squares of the logarithms of its errors."""

    features: FloatArray
    """Shape (F,)."""
    motion_um: FloatArray
    """RMS of the motion in each band, (B,)."""
    blocks: float = 0.0
    mean: float = 0.0
    squares: float = 0.0
    met: int = field(default=0)

    def take(self, value: float, weight: float, most: int) -> None:
        """Add the logarithm of a block's error; errors older than `most` blocks fade."""
        if self.blocks > most - weight:
            self.squares *= (most - weight) / self.blocks
            self.blocks = most - weight
        self.blocks += weight
        away = value - self.mean
        self.mean += away * weight / self.blocks
        self.squares += weight * away * (value - self.mean)


@dataclass(frozen=True)
class Expected:
    """Expected logarithm of a block's error (um), as a Student distribution."""

    middle: float
    scale: float
    freedom: float


class UsualError:
    """The usual error of a model for each kind of motion.

    The motion has `bands` frequency bands. After `memory` blocks of a kind, older ones fade.
    """

    def __init__(self, known: KnownError, bands: int, memory: int) -> None:
        self._memory = memory
        self._begin(np.log(np.append(np.full(bands, known.part_of_motion), known.noise_um)),
                    known.spread)

    def _begin(self, parts: FloatArray, spread: float) -> None:
        """Start with prior logarithms of the fractions and their spread."""
        self._prior, self._prior_spread = parts, spread
        self._parts, self._covariance = parts.copy(), spread**2 * np.eye(parts.size)
        self._kinds: list[_Kind] = []
        self._met, self._unseen = 0, 0
        self._between, self._within = BETWEEN, WITHIN

    def expected(self, motion_um: FloatArray, features: FloatArray) -> Expected:
        """Return the expected error of a block.

        `motion_um` is the RMS of the motion in each band, (B,). Two blocks are of one kind if none
        of their features, (F,), differs by more than 1.
        """
        kind = self._kind(features)
        # The prediction from all kinds; for a known kind, it is weighted with the kind's blocks.
        middles, slopes = self._from_motion((motion_um if kind is None else kind.motion_um)[None])
        middle, slope = float(middles[0]), slopes[0]
        between = self._between**2 + float(slope @ self._covariance @ slope)
        if kind is None:
            # Successive new kinds have similar errors, so each widens the spread.
            between *= 1.0 + self._unseen
            return _wandering(middle, between + self._within**2, BELIEVED_BLOCKS)
        freedom = BELIEVED_BLOCKS + kind.blocks - 1.0
        variance = (BELIEVED_BLOCKS * self._within**2 + kind.squares) / freedom
        worth = variance / between
        return _wandering(
            (worth * middle + kind.blocks * kind.mean) / (worth + kind.blocks),
            variance * (1.0 + 1.0 / (worth + kind.blocks)), freedom)

    def take(self, motion_um: FloatArray, features: FloatArray, value: float,
             weight: float) -> None:
        """Learn from the logarithm of a block's error (um); a known kind has a weight (0 to 1)."""
        expected, kind = self.expected(motion_um, features), self._kind(features)
        is_new = kind is None
        if kind is None:
            if len(self._kinds) == KINDS:
                self._kinds.remove(min(self._kinds, key=lambda each: each.met))
            kind = _Kind(features, motion_um)
            self._kinds.append(kind)
            self._features = np.array([each.features for each in self._kinds])
        self._met += 1
        self._unseen = self._unseen + 1 if is_new else self._unseen // 2
        kind.met = self._met
        furthest = FURTHEST * expected.scale
        kind.take(float(np.clip(value, expected.middle - furthest, expected.middle + furthest)),
                  1.0 if is_new else weight, self._memory)
        if is_new or self._met % self._memory == 0:
            self._pool()

    def grow(self, factor: float) -> None:
        """Expect errors larger by a factor from now on, and relearn those of each kind."""
        growth = float(np.log(factor))
        self._begin(self._parts + growth, growth)

    def _kind(self, features: FloatArray) -> _Kind | None:
        """Return the nearest kind, or None if its features differ by more than 1."""
        if not self._kinds:
            return None
        away = np.abs(self._features - features).max(axis=1)
        nearest = int(np.argmin(away))
        return self._kinds[nearest] if away[nearest] <= 1.0 else None

    def _from_motion(self, motion_um: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log errors predicted for motions (K, B), and their derivatives."""
        powers = np.exp(2.0 * self._parts) * np.column_stack(
            [motion_um**2, np.ones(len(motion_um))])
        total = powers.sum(axis=1)
        return 0.5 * np.log(total), powers / total[:, None]

    def _pool(self) -> None:
        """Estimate the fractions and the spreads from all kinds."""
        motion_um = np.array([kind.motion_um for kind in self._kinds])
        means, blocks, squares = np.array(
            [(kind.mean, kind.blocks, kind.squares) for kind in self._kinds]).T
        repeated = blocks > 1.0
        # Each kind counts once, so that one with many blocks does not dominate.
        self._within = float(np.sqrt(
            (BELIEVED_KINDS * WITHIN**2 + np.sum(squares[repeated] / (blocks[repeated] - 1.0)))
            / (BELIEVED_KINDS + np.count_nonzero(repeated))))
        weights = 1.0 / (self._between**2 + self._within**2 / blocks)
        for _ in range(STEPS):
            middles, slopes = self._from_motion(motion_um)
            normal = (slopes * weights[:, None]).T @ slopes
            self._covariance = np.linalg.inv(
                normal + np.eye(self._prior.size) / self._prior_spread**2)
            step = self._covariance @ (
                slopes.T @ (weights * (means - middles))
                + (self._prior - self._parts) / self._prior_spread**2)
            self._parts = self._parts + np.clip(step, -1.0, 1.0)
        residual = means - self._from_motion(motion_um)[0]
        fitted = float(np.trace(self._covariance @ normal))
        self._between = float(np.sqrt(
            (BELIEVED_KINDS * BETWEEN**2 + residual @ residual)
            / (BELIEVED_KINDS + max(residual.size - fitted, 0.0))))


def _wandering(middle: float, variance: float, freedom: float) -> Expected:
    """Add the variance of `WANDER`, with the degrees of freedom of Satterthwaite (1946)."""
    whole = variance + WANDER**2
    return Expected(middle, float(np.sqrt(whole)), freedom * (whole / variance) ** 2)


@dataclass(frozen=True)
class Change:
    """The evidence for a change."""

    blocks: int
    """Number of blocks since the most likely beginning."""
    factor: float
    """Most likely factor by which the error has grown."""
    logarithm: float
    """Logarithm of the Bayes factor."""


class ChangeEvidence:
    """Sums of the Bayes factors over all beginnings, one for each factor of growth."""

    def __init__(self) -> None:
        self._growth = np.log(FACTORS)
        self._step = float(self._growth[1] - self._growth[0])
        self._logarithms = np.full(FACTORS.size, -np.inf)
        self._blocks = np.zeros(FACTORS.size, dtype=int)

    def add(self, value: float, expected: Expected) -> Change:
        """Add the logarithm of the error (um) of a block, and return the evidence of all blocks."""
        usual = _log_density(value, expected.middle, expected.scale, expected.freedom)
        grown = _log_density(value, expected.middle + self._growth,
                             np.hypot(expected.scale, 0.5 * self._step), expected.freedom)
        self._blocks = np.where(self._logarithms > 0.0, self._blocks + 1, 1)
        self._logarithms = np.logaddexp(0.0, self._logarithms) + grown - usual
        likely = int(np.argmax(self._logarithms))
        return Change(int(self._blocks[likely]), float(FACTORS[likely]), float(
            np.logaddexp.reduce(self._logarithms) - np.log(FACTORS.size)))


def _log_density(value: float, middle: FloatArray | float, scale: FloatArray | float,
                 freedom: float) -> FloatArray:
    """Return the log density of a block's error, including blocks with stray errors."""
    # Student's t; that of scipy.stats checks its arguments for twenty times as long.
    half = 0.5 * (freedom + 1.0)
    height = gammaln(half) - gammaln(0.5 * freedom) - 0.5 * np.log(np.pi * freedom)
    student = height - np.log(scale) - half * np.log1p(((value - middle) / scale) ** 2 / freedom)
    return np.logaddexp(np.log1p(-STRAY) + student, np.log(STRAY / STRAY_RANGE))
