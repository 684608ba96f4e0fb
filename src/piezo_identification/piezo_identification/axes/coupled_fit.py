# SPDX-License-Identifier: BSD-3-Clause
"""Maximum-likelihood fit of a coupled model to spectra of several axes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import pinvh

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.budget import is_time_up
from piezo_identification.axes.coupled_numbers import CoupledNumbers, Linearised
from piezo_identification.axes.shared_poles import TAPS, delays, transient_basis
from piezo_identification.axes.spectra import Spectrum
from piezo_identification.estimators.poles.spectral_input import real_rows
from piezo_identification.estimators.poles.vector_fitting import mode_basis

ROWS_PER_NUMBER = 12
"""Rows whose slopes' squares are summed for each number: neighbouring lines of one mode have nearly
one slope, so that every so many-th stands for them where there are more."""

ENOUGH = 1e-4
"""Relative change of the misfit below which a step ends the fit: a hundredth of an error of 1 %."""

FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e4
"""Damping of the steps, relative to the curvature of the misfit: the first, and the most."""

LESS = 0.8
"""Factor by which a start's softening is reduced until all levels are stable."""

LINES_AT_ONCE = 256
"""Lines whose slopes are held in memory at once, 20 MB for three axes with twenty modes."""

LEAST_INFORMATION = 1e-30
"""Curvature of the misfit over a number, relative to the largest, that is none but rounding."""


@dataclass(frozen=True, eq=False)
class CoupledFit:
    """Numbers of a coupled model with their residuals, and how well they are known."""

    numbers: CoupledNumbers

    residual: list[ComplexArray]
    """Motion that the model and transients do not explain, of each spectrum."""
    misfit: float
    """Sum of the squares of the residual over its deviation."""
    rows: int
    """Real numbers that were fitted."""
    transients: int
    """Numbers of the transients, which were projected out."""

    @property
    def count(self) -> int:
        """Return how many numbers there are, those of the transients among them."""
        return int(self.numbers.shared().size + self.numbers.own().size + self.transients)


def linear_numbers(spectra: Sequence[Spectrum], steps: ComplexArray) -> CoupledNumbers:
    """Return the gains with which modes of given poles fit spectra best."""
    n, columns = spectra[0].motion.shape[1], mode_basis(spectra[0].z, steps).shape[1]
    gains = np.zeros((columns + TAPS, n, n))
    for output in range(n):
        rows, targets = equations_of_gains(spectra, steps, output, np.zeros(1))
        gains[:, output] = _scaled_lstsq(rows, targets[:, 0]).reshape(columns + TAPS, n)
    none = np.zeros((0, columns, n, n))
    return CoupledNumbers(steps, gains[:columns], gains[columns:], none, none[:, 0],
                          spectra[0].amplitude_v, np.ones(columns))


def equations_of_gains(
    spectra: Sequence[Spectrum], steps: ComplexArray, output: int, late: np.ndarray,
) -> tuple[FloatArray, FloatArray]:
    """Return rows, (r, count), and targets, (r, s), of the regression for the gains of one motion.

    There is a target for each of the numbers of samples, (s,), by which the motion is advanced
    first.
    """
    parts = []
    for spectrum in spectra:
        basis = mode_basis(spectrum.z, steps)
        whole = np.hstack([basis, delays(spectrum.z, TAPS)])
        own = (whole[:, :, None] * spectrum.drive[:, None, :]).reshape(len(whole), -1)
        motions = spectrum.motion[:, output, None] * spectrum.z[:, None] ** late
        ahead = replace(spectrum, ahead=spectrum.ahead + int(late.max()))
        parts.append(_cleared(ahead, transient_basis(ahead, steps), output,
                              np.hstack([own, motions])))
    rows = np.concatenate(parts)
    return rows[:, : -late.size], rows[:, -late.size:]


def softened_numbers(linear: CoupledNumbers, levels: Sequence[Sequence[Spectrum]],
                     powers: int, ridge: float = 0.0) -> CoupledNumbers:
    """Return a start for the softening from the responses of other levels to each axis alone.

    With the response ``G`` of a level and that of the reference, ``G back`` is their difference,
    linear in the gains of the modes in ``back``. Modes beyond the lines have none, nor have those
    that are narrower than the distance of two lines, as no line shows their resonance. The squares
    of scaled columns are enlarged by the ridge: gains that the levels hardly show would else make
    the motion unstable.
    """
    n, steps = linear.gains.shape[1], linear.steps
    angles, pairs = np.sort(np.angle(levels[0][0].z)), steps.imag > 0.0
    inside = (np.angle(steps) < angles[-1]) & (-np.log(np.abs(steps)) > np.diff(angles).min())
    start = replace(linear, back=np.zeros((powers, *linear.gains.shape)),
                    back_gain=np.zeros((powers, n, n)), softening=np.concatenate(
                        [np.repeat(inside[pairs], 2), inside[~pairs]]).astype(float))
    for axis in range(n):
        rows, targets = [], []
        for level in levels:
            spectrum, weight = level[axis], level[axis].weight
            strengths = start.strengths(spectrum.amplitude_v)
            gain = np.stack([each.motion for each in level], axis=2)
            matrix = np.einsum("ki,s,m,km,kiq->kismq", weight, strengths, start.softening,
                               mode_basis(spectrum.z, steps), gain, optimize=True)
            rows.append(real_rows(matrix.reshape(weight.size, -1)))
            residual = linear.motions([spectrum])[0] - spectrum.motion
            targets.append(real_rows((weight * residual).reshape(-1)))
        start.back[:, :, :, axis] = _scaled_lstsq(
            np.concatenate(rows), np.concatenate(targets), ridge).reshape(powers, -1, n)
    amplitudes_v = [level[0].amplitude_v for level in levels]
    while not all(start.is_stable(each) for each in amplitudes_v):
        start = replace(start, back=LESS * start.back)
    return start


def refined(numbers: CoupledNumbers, spectra: Sequence[Spectrum], steps: int) -> CoupledFit:
    """Return the numbers near a start with the least residual, by damped Gauss-Newton steps.

    There are fewer steps where the time of the block around is over; with 0 the start is only
    judged.
    """
    residual = _residuals(numbers, spectra)
    misfit, damping = _misfit(spectra, residual), FIRST_DAMPING
    amplitudes_v = {each.amplitude_v for each in spectra} if len(numbers.back) else set()
    for _ in range(steps):
        if is_time_up():
            break
        normal = _Normal(numbers, spectra, residual)
        while True:
            tried = normal.stepped(damping)
            residual_then = _residuals(tried, spectra)
            then = _misfit(spectra, residual_then) if all(
                tried.is_stable(each) for each in amplitudes_v) else np.inf
            if then < misfit or damping > LARGEST_DAMPING:
                break
            damping *= 10.0
        if not then < misfit:
            break
        gained = (misfit - then) / misfit
        numbers, residual, misfit, damping = tried, residual_then, then, damping / 10.0
        if gained < ENOUGH:
            break
    rows = 2 * sum(spectrum.motion.size for spectrum in spectra)
    transients = sum(spectrum.motion.shape[1] * transient_basis(spectrum, numbers.steps).shape[1]
                     for spectrum in spectra if spectrum.transient)
    return CoupledFit(numbers, residual, misfit, rows, transients)


def covariances(fit: CoupledFit, spectra: Sequence[Spectrum]) -> list[FloatArray]:
    """Return for each motion the covariance of its own numbers, with the shared ones behind them.

    It is scaled by the misfit where that is more than the deviations of the spectra make expected.
    """
    normal = _Normal(fit.numbers, spectra, fit.residual)
    return [_scale(fit) * each for each in normal.covariances()]


def covariances_of_correlated(
    fit: CoupledFit, responses: Sequence[Spectrum], covariance: ComplexArray,
) -> list[FloatArray]:
    """Return the covariances for the responses to each axis alone, whose errors are correlated.

    The fit weights each error by its own deviation. Its scatter follows from the slopes and the
    covariance of the errors, (K, n, n, n, n), by line, moving and driven axis, and moving and
    driven axis once more (White, Econometrica 50, 1982).
    """
    numbers, n = fit.numbers, len(responses)
    own, shared = numbers.own().shape[1], numbers.shared().size
    curvature, scatter = np.zeros((2, n * own + shared, n * own + shared))
    for first in range(0, len(covariance), LINES_AT_ONCE):
        lines = slice(first, first + LINES_AT_ONCE)
        part = covariance[lines]
        slopes = np.zeros((len(part), n, n, len(curvature)), dtype=complex)
        for driven, spectrum in enumerate(responses):
            at = Linearised(numbers, spectrum, lines)
            of_own, of_shared = at.own_slopes(), at.shared_slopes()
            for moved in range(n):
                slopes[:, moved, driven, moved * own:(moved + 1) * own] = of_own
                slopes[:, moved, driven, n * own:] = of_shared[moved]
        square = np.stack([each.weight[lines] ** 2 for each in responses], axis=2)
        pulled = square[..., None] * slopes
        curvature += np.einsum("kmdp,kmdq->pq", slopes.conj(), pulled, optimize=True).real
        scatter += 0.5 * np.einsum("kmdp,kmdij,kijq->pq", pulled.conj(), part, pulled,
                                   optimize=True).real
    inverse = _inverse(curvature, 0.0)
    whole = _scale(fit) * inverse @ scatter @ inverse
    places = [np.r_[moved * own:(moved + 1) * own, n * own:len(whole)] for moved in range(n)]
    return [whole[np.ix_(each, each)] for each in places]


def _scale(fit: CoupledFit) -> float:
    """Return by how much the misfit is more than the deviations make expected."""
    return max(1.0, fit.misfit / (0.5 * max(fit.rows - fit.count, 1)))


class _Normal:
    """Normal equations: a block of own numbers for each motion, bordered by the shared ones."""

    def __init__(self, numbers: CoupledNumbers, spectra: Sequence[Spectrum],
                 residual: Sequence[ComplexArray]) -> None:
        self.numbers = numbers
        n, shared = numbers.gains.shape[1], numbers.shared().size
        own = numbers.own().shape[1]
        self.squares = np.zeros((n, own + shared, own + shared))
        self.products = np.zeros((n, own + shared))
        rows = n * sum(2 * each.z.size for each in spectra)
        together = max(1, int(rows / (ROWS_PER_NUMBER * (n * own + shared))))
        for spectrum, rest in zip(spectra, residual, strict=True):
            if spectrum.transient:
                self._add_recording(spectrum, rest)
            else:
                self._add_thinned(spectrum, rest, together)

    def _add_recording(self, spectrum: Spectrum, rest: ComplexArray) -> None:
        at = Linearised(self.numbers, spectrum)
        of_own, of_shared = at.own_slopes(), at.shared_slopes()
        basis = transient_basis(spectrum, self.numbers.steps)
        for output in range(rest.shape[1]):
            rows = _cleared(spectrum, basis, output, np.hstack(
                [of_own, of_shared[output], rest[:, output, None]]))
            self.squares[output] += rows[:, :-1].T @ rows[:, :-1]
            self.products[output] += rows[:, :-1].T @ rows[:, -1]

    def _add_thinned(self, spectrum: Spectrum, rest: ComplexArray, together: int) -> None:
        """Add the squares at every so many-th line, and the products at all lines."""
        count = self.numbers.own().shape[1]
        own, shared = Linearised(self.numbers, spectrum).pulls(spectrum.weight**2 * rest)
        self.products[:, :count] += own
        self.products[0, count:] += shared  # only their sum over the motions counts
        groups = spectrum.z.size // together
        kept = slice(together // 2, groups * together, together)
        at = Linearised(self.numbers, spectrum, kept)
        of_own, of_shared = at.own_slopes(), at.shared_slopes()
        square = np.sum((spectrum.weight[: groups * together] ** 2).reshape(
            groups, together, -1), axis=1)
        for output in range(rest.shape[1]):
            rows = real_rows(
                np.sqrt(square[:, output, None]) * np.hstack([of_own, of_shared[output]]))
            self.squares[output] += rows.T @ rows

    def stepped(self, damping: float) -> CoupledNumbers:
        """Return the numbers after a damped step."""
        inverses, border = self._eliminated(damping)
        count = self.numbers.own().shape[1]
        each_of = list(zip(inverses, self.products, self.squares, strict=True))
        pull = sum(product[count:] - square[:count, count:].T @ inverse @ product[:count]
                   for inverse, product, square in each_of)
        step = np.linalg.lstsq(border, pull, rcond=1e-12)[0]
        own_steps = np.array([inverse @ (product[:count] - square[:count, count:] @ step)
                              for inverse, product, square in each_of])
        return self.numbers.with_numbers(self.numbers.shared() + step,
                                         self.numbers.own() + own_steps)

    def _eliminated(self, damping: float) -> tuple[list[FloatArray], FloatArray]:
        """Return inverses of the blocks, and the matrix of the shared numbers that remains."""
        count = self.numbers.own().shape[1]
        shared = self.squares.shape[1] - count
        border, inverses = np.zeros((shared, shared)), []
        for square in self.squares:
            inverse = _inverse(square[:count, :count], damping)
            across = square[:count, count:]
            border += square[count:, count:] - across.T @ inverse @ across
            inverses.append(inverse)
        total = sum(np.diag(square)[count:] for square in self.squares)
        return inverses, border + damping * np.diag(total)

    def covariances(self) -> list[FloatArray]:
        """Return the covariance of each motion's own numbers with the shared ones."""
        inverses, border = self._eliminated(0.0)
        # A complex error of unit deviation has half of its square in each real row.
        of_shared, count = 0.5 * _inverse(border, 0.0), self.numbers.own().shape[1]
        covariances = []
        for inverse, square in zip(inverses, self.squares, strict=True):
            through = inverse @ square[:count, count:]
            across = -through @ of_shared
            covariances.append(np.block([
                [0.5 * inverse - across @ through.T, across], [across.T, of_shared]]))
        return covariances


def _inverse(square: FloatArray, damping: float) -> FloatArray:
    """Return the inverse of a matrix of normal equations, scaled so that it has ones."""
    scale = np.sqrt(np.maximum(np.diag(square), LEAST_INFORMATION * np.diag(square).max()))
    scaled = square / np.outer(scale, scale) + damping * np.eye(scale.size)
    inverse: FloatArray = pinvh(scaled, rtol=1e-13) / np.outer(
        scale, scale)
    return inverse


def _residuals(numbers: CoupledNumbers, spectra: Sequence[Spectrum]) -> list[ComplexArray]:
    """Return the residual of model and transients in each spectrum."""
    residual = []
    for spectrum, motion in zip(spectra, numbers.motions(spectra), strict=True):
        rest = spectrum.motion - motion
        if spectrum.transient:
            basis = transient_basis(spectrum, numbers.steps)
            for output in range(rest.shape[1]):
                cleared = _cleared(spectrum, basis, output, rest[:, output, None])[:, 0]
                half = cleared.size // 2
                rest[:, output] = (cleared[:half] + 1j * cleared[half:]) / spectrum.weight[
                    :, output]
        residual.append(rest)
    return residual


def _misfit(spectra: Sequence[Spectrum], residual: Sequence[ComplexArray]) -> float:
    return float(sum(np.sum(np.abs(spectrum.weight * rest) ** 2)
                     for spectrum, rest in zip(spectra, residual, strict=True)))


def _cleared(spectrum: Spectrum, transients: ComplexArray, output: int,
             columns: ComplexArray) -> FloatArray:
    """Return weighted columns as real rows, with the transients of a recording projected out."""
    weight = spectrum.weight[:, output, None]
    rows = real_rows(weight * columns)
    if not spectrum.transient:
        return rows
    orthogonal = np.linalg.qr(real_rows(weight * transients))[0]
    cleared: FloatArray = rows - orthogonal @ (orthogonal.T @ rows)
    return cleared


def _scaled_lstsq(rows: FloatArray, targets: FloatArray, ridge: float = 0.0) -> FloatArray:
    norms = np.linalg.norm(rows, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    square = (rows / scale).T @ (rows / scale) + ridge * np.eye(scale.size)
    solution: FloatArray = np.linalg.lstsq(
        square, (rows / scale).T @ targets, rcond=1e-12)[0] / scale
    return solution
