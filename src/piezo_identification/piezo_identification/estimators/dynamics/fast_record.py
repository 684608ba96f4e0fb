# SPDX-License-Identifier: BSD-3-Clause
"""A fast record and least-squares fits to it: with free residues, and with physical parameters."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.fft import prev_fast_len
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.settling import RINGING
from piezo_identification.estimators.dynamics.fast_dynamics import (
    ModeOrder,
    differentiated,
    fast_dynamics_of,
    poles_and_residues,
    with_lags_apart,
)
from piezo_identification.estimators.estimate import without_span
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_identification.estimators.poles.spectral_input import (
    SpectralInput,
    SpectralLines,
    real_rows,
)
from piezo_identification.fitting.evidence import INDEPENDENT, independent_errors, log_evidence
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.vibration_mode import VibrationMode

LEAST_INDEPENDENT = 0.5
"""Smallest fraction of the rows that counts as independent, because correlated errors may come from
the hysteresis, which is estimated later."""

EARLIEST, LATEST = -1.5, 100.0
"""Range of delays that are sought, in sample periods. The earliest is that of a logger that reads
the displacement at the end of the hold, plus half a period."""

FASTEST = 30.0
"""Highest frequency of a pole, relative to half the sample rate: faster poles settle within a
sample period and have no effect."""

NEIGHBOURS = 0.08
"""Logarithm of the ratio of the upper bounds of successive poles. Modes without effect end at these
bounds, and coinciding poles have no partial fractions."""

LEAST_DAMPING, MOST_DAMPING = 1e-5, 20.0
"""Range of damping ratios."""

MOST_GAIN = 3.0
"""Largest factor between the gain at rest and that of the loops. Slow errors of the loops in a fast
record look like slow relaxations, beside which the modes move nearly nothing."""

ANTIRESONANCE_SPAN = 3.0
"""Factor beyond the frequencies of the modes within which a zero is treated as an antiresonance."""

LONG = 20_000
"""Number of rows from which a search uses lines of the spectrum instead of a part of the rows."""

SLOW_TRANSFORM = 200_000
"""Number of rows from which a stretch is cut to a length without large prime factors, whose
transform takes a tenth of the time. Shorter ones are kept whole, with all periods of a
multisine."""

SHORT = 0.1
"""Length, relative to the longest stretch without a gap, below which a stretch is omitted from the
spectrum."""

COLLINEAR = 1e-9
"""Singular value, relative to the largest, below which linearly fitted columns are merged: far
above rounding, far below what any record determines in the presence of noise."""


def bounds_of(kind: type[VibrationMode], parameter: str) -> tuple[float, float]:
    """Return the bounds of a parameter of parallel modes, in its unit."""
    declared = kind.__dataclass_fields__[parameter].metadata
    return declared["low"], declared["high"]


@dataclass(frozen=True, eq=False)
class FastFit:
    """Best-fitting parameters of one order."""

    order: ModeOrder

    vector: FloatArray
    """See `fast_dynamics.fast_dynamics_of`, (P,)."""
    delay: float
    """Delay in sample periods."""
    residual: FloatArray
    """Shape (N,)."""
    jacobian: FloatArray
    """Derivatives by the vector and the delay, or only by the vector if the delay was given, (N, P
    + 1). If two lags are nearly equal, they are taken with the lags apart, see
    `fast_dynamics.with_lags_apart`."""

    @property
    def cost(self) -> float:
        """Sum of the squared residual."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True, eq=False)
class FreeFit:
    """Poles with free residues: dynamics with the same number of modes do not fit better."""

    vector: FloatArray
    """Vector of dynamics with the lag and m modes in series, (1 + 2 m,)."""
    delay: float
    """Delay in sample periods."""
    residual: FloatArray
    """Shape (N,)."""
    poles: ComplexArray
    residues: ComplexArray
    """Shape (1 + 2 m,)."""

    @property
    def modes(self) -> int:
        """Number of modes."""
        return self.vector.size // 2

    @property
    def numbers(self) -> int:
        """Return the number of fitted parameters: poles, residues, and the delay."""
        return 2 * self.poles.size + 1

    @property
    def cost(self) -> float:
        """Sum of the squared residual."""
        return float(self.residual @ self.residual)

    def antiresonances(self) -> FloatArray:
        """Return frequencies (rad/s) and damping ratios of zeros near the modes, shape (2, k)."""
        modes = self.poles[1:]
        if not modes.size:
            return np.empty((2, 0))
        scale = np.abs(self.poles).max()
        poles, numerator = self.poles / scale, np.zeros(1, dtype=complex)
        for i, residue in enumerate(self.residues):
            numerator = np.polyadd(numerator, residue * np.poly(np.delete(poles, i)))
        zeros = np.roots(numerator.real) * scale
        low, high = np.abs(modes).min(), np.abs(modes).max()
        zeros = zeros[(zeros.imag > 0.0) & (np.abs(zeros) > low / ANTIRESONANCE_SPAN)
                      & (np.abs(zeros) < high * ANTIRESONANCE_SPAN)][: self.modes]
        # Zeros in the right half plane are no antiresonances: they start from the imaginary axis.
        return np.array([np.abs(zeros), np.maximum(-zeros.real / np.abs(zeros), 1e-3)])


@dataclass(frozen=True, eq=False)
class FastRecord:
    """An input, the measured output, and further signals that the output may contain."""

    input: HeldInput | SpectralInput

    kept: NDArray[np.intp]
    """Indices of the fitted samples, or rows of lines, (N,). If the input is not periodic, the last
    two samples are excluded."""
    measured_um: FloatArray
    """Measured displacement of the kept samples, with the creep removed, (N,)."""
    fixed: FloatArray
    """Further signals in these samples, such as an offset, (N, K); fitted linearly, as is the
    gain."""
    every_row: "FastRecord | None" = None
    """Full record, if this one is a thinned copy; by default itself."""
    phase_room: float = 0.0
    """Fraction of a sample period by which the whole input may be earlier or later."""
    is_driven_by_loops: bool = False
    """Whether the input is the displacement that known loops predict for slow motion."""
    slowest_rad_per_s: float = 0.0
    """Frequency below which lines of the spectrum are left out."""
    _span: FloatArray = field(init=False, repr=False)
    _target: FloatArray = field(init=False, repr=False)
    _thinned: "dict[int, FastRecord]" = field(init=False, repr=False, default_factory=dict)
    _lines: "dict[int, FastRecord]" = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_span", independent(self.fixed))
        object.__setattr__(self, "_target", without_span(self.measured_um, self._span))

    @property
    def linear_parameters(self) -> int:
        """Number of parameters that are fitted linearly: the gain and the fixed columns."""
        return 1 + self._span.shape[1]

    def log_evidence(self, fit: FastFit | FreeFit, numbers: int,
                     independent: float = INDEPENDENT) -> float:
        """Return the log-evidence of a fit with this many parameters besides the fixed columns.

        At most `independent` errors count, and no more than there are rows.
        """
        rows = fit.residual.size
        accuracy_um = FIT.model_tolerance * np.ptp((self.every_row or self).measured_um)
        return log_evidence(fit.cost / rows + accuracy_um**2,
                            numbers + self._span.shape[1], min(rows, independent))

    def independent_errors(self, fit: FastFit | FreeFit) -> float:
        """Return the number of independent errors of a fit, within the limits of what may count."""
        if self.every_row:
            return INDEPENDENT
        fewest = min(LEAST_INDEPENDENT * fit.residual.size, INDEPENDENT)
        return max(independent_errors(fit.residual), fewest)

    def thinned(self, most_rows: int) -> "FastRecord":
        """Return the record with at most the given number of rows, spread over all of it; cached.

        The rows of a long record are lines of its spectrum, which need no recursion over samples.
        """
        step = -(-self.kept.size // most_rows)
        if step == 1:
            return self
        if step not in self._thinned:
            self._thinned[step] = (
                self.at_lines(most_rows // 2) if self.is_long else FastRecord(
                    self.input, self.kept[::step], self.measured_um[::step], self.fixed[::step],
                    self.every_row or self, self.phase_room))
        return self._thinned[step]

    @property
    def is_on_the_clock(self) -> bool:
        """Return whether the input changes at its samples only."""
        return not isinstance(self.input, HeldInput) or self.input.early is None

    @property
    def is_long(self) -> bool:
        """Return whether lines of its spectrum represent the record where it is thinned."""
        return (isinstance(self.input, HeldInput) and not self.input.is_periodic
                and self.is_on_the_clock and self.kept.size > LONG)

    def at_lines(self, count: int) -> "FastRecord":
        """Return the record at about the given number of lines of its spectrum; cached."""
        if self.every_row is not None:
            return self.every_row.at_lines(count)
        if count not in self._lines:
            self._lines[count] = self._at_lines(count)
        return self._lines[count]

    def _at_lines(self, count: int) -> "FastRecord":
        size, given = self.input.samples.size, self.input
        ends = np.flatnonzero(np.diff(self.kept) != 1)
        every = [slice(int(first), int(last) + 1) for first, last in zip(
            self.kept[np.concatenate([[0], ends + 1])],
            self.kept[np.concatenate([ends, [-1]])], strict=True)]
        longest = max(each.stop - each.start for each in every)
        stretches = tuple(
            each for each in every if each.stop - each.start > SHORT * longest)
        if longest > SLOW_TRANSFORM and not given.is_periodic:
            stretches = tuple(
                slice(each.start, each.start + prev_fast_len(each.stop - each.start, real=True))
                for each in stretches)
        lines = SpectralLines.excited_by(
            given.samples, stretches, count, self.slowest_rad_per_s * given.sample_period_s)

        def rows(values: FloatArray) -> FloatArray:
            signal = np.zeros(size)
            signal[self.kept] = values
            return real_rows(lines.of(signal))

        measured_um = rows(self.measured_um)
        return FastRecord(
            SpectralInput(given.samples, given.sample_period_s, lines.phases(),
                          lines.of(given.samples), tuple(each.size for each in lines.lines),
                          given.is_periodic),
            np.arange(measured_um.size), measured_um,
            np.column_stack([rows(column) for column in self._span.T]), self, self.phase_room)

    def fit(self, order: ModeOrder, vector: FloatArray, delay: float,
            evaluations: int = 100, is_delay_free: bool = True,
            tolerance: float = 1e-8) -> FastFit:
        """Fit the parameters of an order by least squares, from a start."""
        lower, upper = self._bounds(order, vector.size)

        def full(unknowns: FloatArray) -> FloatArray:
            return unknowns if is_delay_free else np.append(unknowns, delay)

        begin = np.append(vector, delay) if is_delay_free else vector
        lower, upper = lower[: begin.size], upper[: begin.size]
        problem = _Remembered(lambda unknowns: self.errors(order, full(unknowns)))
        solution = least_squares(
            lambda unknowns: problem.at(unknowns)[0], np.clip(begin, lower + 1e-9, upper - 1e-9),
            lambda unknowns: problem.at(unknowns)[1][:, : begin.size], bounds=(lower, upper),
            x_scale="jac", xtol=tolerance, ftol=tolerance, gtol=1e-15, max_nfev=evaluations)
        best = full(solution.x)
        residual, jacobian = self.errors(order, best)
        apart = with_lags_apart(best[:-1], order)
        if np.any(apart != best[:-1]):
            jacobian = self.errors(order, np.append(apart, best[-1]))[1]
        return FastFit(order, best[:-1], float(best[-1]), residual, jacobian[:, : begin.size])

    def errors(self, order: ModeOrder, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual with the best-fitting gain, and its exact Jacobian (N, P + 1)."""
        check_cancelled()
        poles, residues, by_pole, by_residue = differentiated(unknowns[:-1], order)
        # One of each conjugate pair is computed, and its real part counts twice.
        own = poles.imag >= 0.0
        twice = np.where(poles.imag[own] > 0.0, 2.0, 1.0)
        answers = self.input.responses(poles[own], float(unknowns[-1]), self.kept)
        residues, by_pole = twice * residues[own], by_pole[own]
        by_residue = twice[:, None] * by_residue[own]
        columns = np.column_stack([
            real_products([answers.value, answers.by_pole], [
                np.column_stack([residues, by_residue]),
                np.column_stack([np.zeros_like(residues), residues[:, None] * by_pole])]),
            real_products([answers.by_delay], [residues[:, None]]),
        ])
        span, target = self._projected_out(poles)
        columns = without_span(columns, span)
        response, slopes = columns[:, 0], columns[:, 1:]
        energy = response @ response
        gain = response @ target / energy
        by_gain = (slopes.T @ target - 2.0 * gain * (slopes.T @ response)) / energy
        return (target - gain * response,
                -gain * slopes - np.outer(response, by_gain))

    def fit_free(self, vector: FloatArray, delay: float, evaluations: int = 40) -> FreeFit:
        """Fit poles and delay with free residues by least squares, from a start."""
        order = ModeOrder(vector.size // 2)
        lower, upper = self._bounds(order, vector.size)
        problem = _Remembered(lambda unknowns: self._free_errors(order, unknowns)[:2])
        solution = least_squares(
            lambda unknowns: problem.at(unknowns)[0],
            np.clip(np.append(vector, delay), lower + 1e-9, upper - 1e-9),
            lambda unknowns: problem.at(unknowns)[1], bounds=(lower, upper),
            x_scale="jac", xtol=1e-8, ftol=1e-8, max_nfev=evaluations)
        return self.free(solution.x[:-1], float(solution.x[-1]))

    def free(self, vector: FloatArray, delay: float) -> FreeFit:
        """Return the fit with the best residues for given poles and delay."""
        order = ModeOrder(vector.size // 2)
        residual, _, poles, residues = self._free_errors(order, np.append(vector, delay), False)
        return FreeFit(vector, delay, residual, poles, residues)

    def parts(self, orders_and_vectors: list[tuple[ModeOrder, FloatArray]],
              delay: float) -> tuple[FloatArray, float]:
        """Gains of several parallel responses that fit best, and the remaining cost."""
        columns, all_poles = [], []
        for order, vector in orders_and_vectors:
            poles, residues = poles_and_residues(vector[None], order)
            answer = self.input.responses(poles[0], delay, self.kept).value @ residues[0]
            columns.append(answer.real)
            all_poles.append(poles[0])
        span, target = self._projected_out(np.unique(np.concatenate(all_poles)))
        basis = without_span(np.column_stack(columns), span)
        gains: FloatArray = np.linalg.lstsq(basis, target, rcond=COLLINEAR)[0].astype(float)
        return gains, float(np.sum((target - basis @ gains) ** 2))

    def _free_errors(
        self, order: ModeOrder, unknowns: FloatArray, with_slopes: bool = True,
    ) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
        """Residual, its Jacobian (after Kaufman), poles and residues."""
        check_cancelled()
        vector, delay = unknowns[:-1], float(unknowns[-1])
        poles, _, by_vector, _ = differentiated(vector, order)
        answers = self.input.responses(poles, delay, self.kept)
        one, other = answers.value[:, 1::2], answers.value[:, 2::2]
        apart = poles[1::2] - poles[2::2]
        scale = np.abs(poles[1::2])
        # Real for conjugate poles as well as for two real ones.
        basis = np.column_stack([
            answers.value[:, :1], one + other, (one - other) * (scale / apart)]).real
        span, target = self._projected_out(poles)
        basis = without_span(basis, span)
        norms = np.linalg.norm(basis, axis=0)
        left, values, right = np.linalg.svd(basis / norms, full_matrices=False)
        kept = values > COLLINEAR * values[0]
        left = left[:, kept]
        projected = left.T @ target
        gains = right[kept].T @ (projected / values[kept]) / norms
        residual = target - left @ projected
        count = apart.size
        even, odd = gains[1 : 1 + count], gains[1 + count :] * scale / apart
        residues = np.empty(poles.size, dtype=complex)
        residues[0], residues[1::2], residues[2::2] = gains[0], even + odd, even - odd
        if not with_slopes:
            return residual, np.empty((residual.size, 0)), poles, residues
        slopes = np.column_stack([
            (answers.by_pole @ (residues[:, None] * by_vector)).real,
            (answers.by_delay @ residues).real])
        slopes = without_span(slopes, span)
        return residual, left @ (left.T @ slopes) - slopes, poles, residues

    def gain(self, fit: FastFit) -> float:
        """Return the gain of a fit at rest."""
        poles, residues = (each[0] for each in poles_and_residues(fit.vector[None], fit.order))
        response = (self.input.responses(poles, fit.delay, self.kept).value @ residues).real
        span, target = self._projected_out(poles)
        response = without_span(response[:, None], span)[:, 0]
        return float(response @ target / (response @ response))

    def contradicts_loops(self, fit: FastFit) -> bool:
        """Return whether the gain of a fit is far from that of the loops that drive the record."""
        return (self.every_row or self).is_driven_by_loops and not (
            1.0 / MOST_GAIN <= self.gain(fit) <= MOST_GAIN)

    def beyond_record(self, fit: FastFit) -> str:
        """Return which part of a fit the record cannot show; an empty text if none is."""
        longest = self._bounds(fit.order, fit.vector.size)[1][0]
        if fit.vector[0] > longest - NEIGHBOURS:
            return "a lag as long as the record"
        dynamics, effects = fast_dynamics_of(fit.vector, fit.order)
        modes = [*zip(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True), *(
            (mode.frequency_rad_per_s, mode.damping_ratio) for mode in effects
            if isinstance(mode, VibrationMode))]
        period_s = self.input.sample_period_s
        if any(2.0 * np.pi > rate * period_s * self.input.samples.size for rate, _ in modes):
            return "a mode whose period is longer than the record"
        is_faster = any(damping < RINGING and rate * period_s > np.pi for rate, damping in modes)
        return "a mode that rings faster than the rows show" if is_faster else ""

    def _bounds(self, order: ModeOrder, size: int) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the vector and the delay, from what the samples can show."""
        period_s = self.input.sample_period_s
        duration_s = self.input.samples.size * period_s
        lag = np.log([1e-3 * period_s, duration_s])
        slowest, fastest = np.log([1.0 / duration_s, FASTEST * np.pi / period_s])
        damping = np.log([LEAST_DAMPING, MOST_DAMPING])

        def rates(count: int) -> list[FloatArray]:
            return [np.array([slowest, fastest - place * NEIGHBOURS]) for place in range(count)]

        limits = [lag, *rates(order.modes), *[damping] * order.modes]
        limits += [*rates(order.antiresonances), *[damping] * order.antiresonances]
        kind = CoupledMode if order.is_coupled else VibrationMode
        shares = bounds_of(kind, "participation")
        of_modes = damping if order.is_coupled else np.log(bounds_of(kind, "damping_ratio"))
        limits += [*rates(order.parallel), *[of_modes] * order.parallel]
        limits += [*[lag] * order.sensor_lags, *[np.array(shares)] * order.shares]
        limits += [np.array([EARLIEST, min(LATEST, 0.25 * self.input.samples.size)])]
        lower, upper = np.array(limits).T
        return lower, upper

    def _projected_out(self, poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Return orthonormal columns of the further signals, and the target without them."""
        if isinstance(self.input, HeldInput):
            return self._span, self._target
        transients = independent(self.input.transients(poles), self._span)
        return np.column_stack([self._span, transients]), without_span(self._target, transients)


class _Remembered:
    """A residual and its Jacobian, evaluated together and cached, reduced to few rows.

    A least-squares step needs only their inner products, which a QR decomposition preserves.
    """

    def __init__(self, evaluate: Callable[[FloatArray], tuple[FloatArray, FloatArray]]) -> None:
        self._evaluate = evaluate
        self._point: FloatArray | None = None
        self._value: tuple[FloatArray, FloatArray] | None = None

    def at(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual and Jacobian at a point, with one more row than there are unknowns."""
        if self._value is None or self._point is None or not np.array_equal(point, self._point):
            residual, jacobian = self._evaluate(point)
            triangle = np.asarray(
                np.linalg.qr(np.column_stack([jacobian, residual]), mode="r"))
            self._point, self._value = point.copy(), (triangle[:, -1], triangle[:, :-1])
        return self._value


def real_products(signals: list[ComplexArray], weights: list[ComplexArray]) -> FloatArray:
    """Real part of the sum of signals, (N, n), times weights, (n, P), with real numbers, (N, P)."""
    # The transposes are contiguous in memory as computed.
    parts = np.concatenate([part for each in signals for part in (each.T.real, each.T.imag)])
    factors = np.concatenate([part for each in weights for part in (each.real, -each.imag)])
    product: FloatArray = parts.T @ factors
    return product


def independent(columns: FloatArray, span: FloatArray | None = None) -> FloatArray:
    """Return orthonormal columns of the span of columns, (N, K), without directions of rounding.

    Slow exponentials are nearly equal in a short record. If they were kept as they are, the minimum
    would be obscured by rounding errors, and a search would end anywhere near it. The columns
    returned are orthogonal to the orthonormal ones of `span`, (N, M), if it is given.
    """
    norms = np.linalg.norm(columns, axis=0)
    # A decay that ends before the record begins is zero throughout.
    columns = columns[:, norms > 0.0] / norms[norms > 0.0]
    span = np.empty((len(columns), 0)) if span is None else span
    left, values, _ = np.linalg.svd(without_span(columns, span), full_matrices=False)
    # Small columns contain rounding errors along `span`, too.
    return without_span(left[:, values > COLLINEAR], span)
