# SPDX-License-Identifier: BSD-3-Clause
"""Rational fit of a frequency response, or of a record at lines of its spectrum, by vector fitting.

The poles are relocated by linear regressions (Gustavsen and Semlyen, "Rational approximation of
frequency domain responses by vector fitting", 1999), so that no starting guess is needed.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.poles.spectral_input import real_rows

LINES = 600
"""Number of lines or frequencies from which poles are sought if there are more; fits use all."""

FIRST_DAMPING = 0.02
"""Damping ratio of the poles at the start, as of a metal flexure with its actuators; the iteration
moves poles by more than their width at once."""

RELOCATIONS = 8
"""Number of regressions of a vector fit, after which its poles hardly change."""


@dataclass(frozen=True, eq=False)
class Lines:
    """An output that is a sum of inputs, each filtered by a rational function of common poles."""

    rate_rad_per_s: FloatArray
    """Positive, (N,)."""
    output: ComplexArray
    """For a single input of 1, a measured response, (N,)."""
    inputs: ComplexArray | None = None
    """By default 1, (N, K)."""
    further: ComplexArray | None = None
    """Further signals that the output may contain, with real coefficients, (N, L); by default
    none."""
    weight: FloatArray | float = 1.0
    """Weight of the error of each line, (N,)."""

    def columns(self, basis: ComplexArray) -> ComplexArray:
        """Return the regressors of the output for given responses of poles, (N, n)."""
        whole = np.column_stack([basis, np.ones(basis.shape[0])])
        inputs = np.ones((whole.shape[0], 1)) if self.inputs is None else self.inputs
        further = [] if self.further is None else [self.further]
        return np.hstack([*(each[:, None] * whole for each in inputs.T), *further])


def vector_fit(lines: Lines, pole_count: int) -> ComplexArray:
    """Return stable poles (rad/s) of proper rational functions that approximate an output.

    Raise ValueError if there are too few frequencies for so many.
    """
    rate = lines.rate_rad_per_s
    if rate.size <= pole_count:
        raise ValueError(
            f"{rate.size} frequencies are too few for {pole_count} poles: measure more or ask for "
            "a lower order"
        )
    scale = rate.max()
    s = 1j * rate / scale
    # The initial poles are distributed as the measured frequencies.
    ranks = np.linspace(0.0, 1.0, pole_count // 2 + 2)[1:-1]
    pairs = np.quantile(rate, ranks) / scale
    poles = np.concatenate([(-FIRST_DAMPING + 1j) * pairs, (-FIRST_DAMPING - 1j) * pairs])
    if pole_count % 2:
        poles = np.append(poles, -0.1)
    for _ in range(RELOCATIONS):
        basis, (dynamics, drive) = mode_basis(s, poles), real_form(poles)
        columns = np.hstack([lines.columns(basis), -lines.output[:, None] * basis])
        solution = _real_lstsq(lines.weight, columns, lines.output)
        poles = np.linalg.eigvals(dynamics - np.outer(drive, solution[-pole_count:]))
        poles = -np.maximum(np.abs(poles.real), 1e-9) + 1j * poles.imag
    return poles * scale


def residual_of_poles(lines: Lines, poles: ComplexArray) -> ComplexArray:
    """Return the residual of the best rational functions with given poles, shape (N,).

    The poles (rad/s), (n,), are closed under conjugation.
    """
    scale = lines.rate_rad_per_s.max()
    columns = lines.columns(mode_basis(1j * lines.rate_rad_per_s / scale, poles / scale))
    return lines.output - columns @ _real_lstsq(lines.weight, columns, lines.output)


def mode_basis(z: ComplexArray, steps: ComplexArray) -> ComplexArray:
    """Return the responses whose real multiples are those of modes, (K, 2 pairs + real poles).

    The columns of pairs, by their upper pole, come before those of real poles. Of the poles in the
    z plane or the s plane, (m,), those in the lower half are left out.
    """
    pairs = steps[steps.imag > 0.0]
    columns = np.empty((z.size, 2 * pairs.size + np.count_nonzero(steps.imag == 0.0)), complex)
    upper, lower = (1.0 / (z[:, None] - each) for each in (pairs, pairs.conj()))
    columns[:, 0:2 * pairs.size:2] = upper + lower
    columns[:, 1:2 * pairs.size:2] = 1j * (upper - lower)
    columns[:, 2 * pairs.size:] = 1.0 / (z[:, None] - steps[steps.imag == 0.0])
    return columns


def real_form(steps: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return real dynamics and drive whose states respond as `mode_basis`."""
    pairs, real = steps[steps.imag > 0.0], steps[steps.imag == 0.0].real
    dynamics = np.diag(np.concatenate([np.repeat(pairs.real, 2), real]))
    drive = np.ones(len(dynamics))
    for at, step in enumerate(pairs):
        dynamics[2 * at, 2 * at + 1], dynamics[2 * at + 1, 2 * at] = step.imag, -step.imag
        drive[2 * at: 2 * at + 2] = 2.0, 0.0
    return dynamics, drive


def _real_lstsq(weight: FloatArray | float, columns: ComplexArray,
                target: ComplexArray) -> FloatArray:
    stacked = real_rows((weight * columns.T).T)
    scale = np.linalg.norm(stacked, axis=0)
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(stacked / scale, real_rows(weight * target), rcond=None)[0]
    return solution / scale
