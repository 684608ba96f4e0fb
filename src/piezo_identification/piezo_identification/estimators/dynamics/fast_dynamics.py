# SPDX-License-Identifier: BSD-3-Clause
"""Lags, modes in series and in parallel, and antiresonances, as poles and residues."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.effect import Effect
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_models.linear.dynamics_vector import dynamics_of_vector, split_dynamics_vector

APART = 1e-5
"""Smallest relative distance of poles, so that each has a residue."""

STEP = 1e-6
"""Step of the derivatives of poles and residues: somewhat above the square root of the
precision."""

ALIKE = 1e-2
"""Logarithm of the ratio of two lags below which derivatives are taken at this ratio. The response
depends on the square of their difference, so that the derivative by it vanishes at 0."""


@dataclass(frozen=True)
class ModeOrder:
    """Numbers of components."""

    modes: int
    """Modes in series (4.3)."""
    antiresonances: int = 0
    """Antiresonances between them."""
    parallel: int = 0
    """Modes in parallel, each of which contributes a part of the displacement."""
    sensor_lags: int = 0

    is_coupled: bool = False
    """Whether the parallel modes also have parts proportional to their velocities. With no mode in
    series, these are all proper dynamics behind a lag."""

    def __str__(self) -> str:
        text = f"{self.modes}"
        if self.antiresonances:
            text += f"-{self.antiresonances}"
        if self.parallel:
            text += f"+{self.parallel}"
        return text + " lag" * self.sensor_lags + " coupled" * self.is_coupled

    @property
    def parameters(self) -> int:
        """Length of the vector: lags, two numbers per mode in series, more per parallel mode."""
        return self.positive + self.shares

    @property
    def positive(self) -> int:
        """Number of elements of the vector that are logarithms."""
        return 1 + 2 * (self.modes + self.antiresonances + self.parallel) + self.sensor_lags

    @property
    def shares(self) -> int:
        """Number of elements at the end of the vector that are parts of the displacement."""
        return self.parallel * (1 + self.is_coupled)


def coupled_vector(poles: ComplexArray, residues: ComplexArray) -> FloatArray:
    """Return the vector, (1 + 4 m,), of ``ModeOrder(0, 0, m, is_coupled=True)``.

    Poles and residues, (1 + 2 m,), are the lag, then adjacent pairs of poles, each conjugate or
    both real, with any gain at rest.
    """
    rest = np.sum(-residues / poles).real
    through_lag = residues * (1.0 - poles / poles[0]) / rest
    one, other = poles[1::2], poles[2::2]
    w = np.sqrt((one * other).real)
    zeta = -(one + other).real / (2.0 * w)
    first, second = through_lag[1::2], through_lag[2::2]
    position = -(first * other + second * one).real / w**2
    velocity = (first + second).real / w
    return np.concatenate([
        np.log([-1.0 / poles[0].real, *w, *np.maximum(zeta, 1e-9)]), position, velocity])


def values_of(vector: FloatArray, order: ModeOrder) -> FloatArray:
    """Physical values of a vector, (P,), or of several, (B, P), in their order."""
    return np.concatenate(
        [np.exp(vector[..., : order.positive]), vector[..., order.positive :]], axis=-1)


def fast_dynamics_of(
    vector: FloatArray, order: ModeOrder,
) -> tuple[ElectricVibrationDynamics, tuple[Effect, ...]]:
    """Return the dynamics of a vector, and additional effects: parallel modes and a sensor lag.

    The vector, (P,), contains logarithms of positive values: the lag; frequencies and damping
    ratios of the modes in series, of the antiresonances and of the parallel modes; the sensor lag.
    The participations of the parallel modes follow. All modes are returned in order of frequency.
    """
    values = values_of(vector[ascending_places(vector, order)], order)
    main, frequencies, dampings, lags, *shares = _split(values, order)
    kind = CoupledMode if order.is_coupled else VibrationMode
    parallel = (kind(*numbers) for numbers in zip(*(
        each.tolist() for each in (frequencies, dampings, *shares)), strict=True))
    return (dynamics_of_vector(main, order.modes, order.antiresonances),
            (*parallel, *(SensorLag(lag) for lag in lags.tolist())))


def ascending_places(vector: FloatArray, order: ModeOrder) -> np.ndarray:
    """Indices into a vector that put the components of every kind in order of frequency."""
    main, frequencies, dampings, lag, *shares = _split(np.arange(vector.size), order)
    modes, zeros = order.modes, order.antiresonances
    first, w, zeta, wz, zetaz = np.split(main, np.cumsum([1, modes, modes, zeros]))
    by_mode, by_zero = np.argsort(vector[w]), np.argsort(vector[wz])
    by_side = np.argsort(vector[frequencies])
    return np.concatenate([
        first, w[by_mode], zeta[by_mode], wz[by_zero], zetaz[by_zero], frequencies[by_side],
        dampings[by_side], lag, *(each[by_side] for each in shares)])


def split_deviations(
    deviations: FloatArray, order: ModeOrder,
) -> tuple[dict[str, object], tuple[dict[str, float], ...]]:
    """Split standard deviations in the order of a vector's values, (P,).

    Return those of the dynamics by the names of the fields of `ElectricVibrationDynamics`, and
    those of parallel modes, then of the sensor lag, by parameter name.
    """
    main, frequencies, dampings, lag, *shares = _split(deviations, order)
    names = "frequency_rad_per_s", "damping_ratio", "participation", "velocity_participation"
    parallel = [dict(zip(names, map(float, numbers), strict=False))
                for numbers in zip(frequencies, dampings, *shares, strict=True)]
    return split_dynamics_vector(main, order.modes, order.antiresonances), (
        *parallel, *({"time_constant_s": float(value), "roundness": 0.0} for value in lag))


def _split(values: np.ndarray, order: ModeOrder) -> list[np.ndarray]:
    """Split a vector: dynamics, frequencies and dampings of parallel modes, sensor lag, shares."""
    shares = [order.parallel] * order.is_coupled
    return np.split(values, np.cumsum([
        1 + 2 * (order.modes + order.antiresonances), order.parallel, order.parallel,
        order.sensor_lags, *shares]), axis=-1)


def lag_difference(vector: FloatArray, order: ModeOrder) -> float:
    """Half the logarithm of the ratio of the lag to the sensor lag."""
    return 0.5 * float(vector[0] - vector[order.positive - 1])


def with_lags_apart(vector: FloatArray, order: ModeOrder) -> FloatArray:
    """Return a vector, (P,), whose two lags are not nearly equal; unchanged for a single lag."""
    if not order.sensor_lags:
        return vector
    half = lag_difference(vector, order)
    if abs(half) >= 0.5 * ALIKE:
        return vector
    by = np.copysign(0.5 * ALIKE, half) - half
    apart = vector.copy()
    apart[0] += by
    apart[order.positive - 1] -= by
    return apart


def poles_and_residues(
    vectors: FloatArray, order: ModeOrder,
) -> tuple[ComplexArray, ComplexArray]:
    """Return partial fractions of dynamics with unit gain at rest.

    For vectors of `fast_dynamics_of`, (B, P), poles and residues are (B, n): lag, sensor lag, then
    the modes in pairs. The response is the sum of r / (s - p).
    """
    main, side_w, side_zeta, sensor, parts, *velocities = _split(values_of(vectors, order), order)
    tau, w, zeta, wz, zetaz = np.split(
        main, np.cumsum([1, order.modes, order.modes, order.antiresonances]), axis=-1)
    lags = -1.0 / np.concatenate([tau, _away_from(sensor, tau)], axis=-1)
    series, side = _pairs(w, zeta), _pairs(side_w, side_zeta)
    poles = np.concatenate([lags.astype(complex), series, side], axis=-1)

    def numerator(s: ComplexArray) -> ComplexArray:
        ratio = s[..., None] / wz[:, None, :]
        return np.prod(1.0 + 2.0 * zetaz[:, None, :] * ratio + ratio**2, axis=-1)

    main_gain = 1.0 - parts.sum(axis=-1)[:, None]
    through_series = main_gain * numerator(poles) * _over(poles, series)
    shares = parts[:, None, :]
    for velocity in velocities:
        shares = shares + velocity[:, None, :] * poles[:, :, None] / side_w[:, None, :]
    shares = np.broadcast_to(shares, (*poles.shape, order.parallel))
    through_side = [shares[:, :, i] * _over(poles, side[:, 2 * i : 2 * i + 2])
                    for i in range(order.parallel)]
    # The branches add up at the poles of the lags; only its own branch is infinite at a pole.
    branch = through_series + sum(through_side, np.zeros_like(poles))
    first = lags.shape[-1]
    own = [through_series, *through_side]
    for part, size in zip(own, [2 * order.modes] + [2] * order.parallel, strict=True):
        branch[:, first : first + size] = part[:, first : first + size]
        first += size
    return poles, -poles * branch * _over(poles, lags.astype(complex))


def _over(points: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Evaluate the product of 1 / (1 - s / p), without the factor of a pole at that pole."""
    factors = 1.0 - points[:, :, None] / poles[:, None, :]
    factors[points[:, :, None] == poles[:, None, :]] = 1.0
    return 1.0 / np.prod(factors, axis=-1)


def _pairs(frequencies: FloatArray, dampings: FloatArray) -> ComplexArray:
    """Poles of modes, shape (B, 2 m), never exactly critically damped."""
    excess = dampings**2 - 1.0
    excess = np.where(np.abs(excess) < APART, APART, excess).astype(complex)
    root = np.sqrt(excess)
    poles = frequencies[..., None] * np.stack([-dampings + root, -dampings - root], axis=-1)
    return np.asarray(poles.reshape(len(frequencies), -1), dtype=complex)


def _away_from(times: FloatArray, others: FloatArray) -> FloatArray:
    """Return times that differ from others."""
    return np.where(np.abs(times / others - 1.0) < APART, others * (1.0 + APART), times)


def differentiated(
    vector: FloatArray, order: ModeOrder,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Poles, residues (n,), and their derivatives (n, P) by the vector."""
    steps = STEP * np.eye(vector.size)
    poles, residues = poles_and_residues(
        np.concatenate([vector[None], vector + steps, vector - steps]), order)
    size = vector.size
    return (poles[0], residues[0], (poles[1 : size + 1] - poles[size + 1 :]).T / (2.0 * STEP),
            (residues[1 : size + 1] - residues[size + 1 :]).T / (2.0 * STEP))
