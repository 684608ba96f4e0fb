# SPDX-License-Identifier: BSD-3-Clause
"""Rational fit of a frequency response, or of a record at lines of its spectrum, by vector fitting.

The poles are relocated by linear regressions (Gustavsen and Semlyen, "Rational approximation of
frequency domain responses by vector fitting", 1999), so that no starting guess is needed.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray

LINES = 600
"""Number of lines or frequencies from which poles are sought if there are more; fits use all."""

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
    poles = np.concatenate([(-0.02 + 1j) * pairs, (-0.02 - 1j) * pairs])
    if pole_count % 2:
        poles = np.append(poles, -0.1)
    for _ in range(RELOCATIONS):
        dynamics, drive, basis = _basis(s, poles)
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
    columns = lines.columns(_basis(1j * lines.rate_rad_per_s / scale, poles / scale)[2])
    return lines.output - columns @ _real_lstsq(lines.weight, columns, lines.output)


def _basis(s: ComplexArray, poles: ComplexArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Real state space with these poles, and the responses of its states, (N, n)."""
    pairs, real = poles[poles.imag > 0.0], poles[poles.imag == 0.0].real
    dynamics, drive = np.diag(np.concatenate([np.repeat(pairs.real, 2), real])), np.ones(poles.size)
    for i, pole in enumerate(pairs):
        dynamics[2 * i, 2 * i + 1], dynamics[2 * i + 1, 2 * i] = pole.imag, -pole.imag
        drive[2 * i : 2 * i + 2] = 2.0, 0.0
    columns = []
    for pole in pairs:
        one, other = 1.0 / (s - pole), 1.0 / (s - pole.conjugate())
        columns += [one + other, 1j * (one - other)]
    columns += [1.0 / (s - pole) for pole in real]
    return dynamics, drive, np.column_stack(columns)


def _real_lstsq(weight: FloatArray | float, columns: ComplexArray,
                target: ComplexArray) -> FloatArray:
    columns, target = (weight * columns.T).T, weight * target
    stacked = np.vstack([columns.real, columns.imag])
    scale = np.linalg.norm(stacked, axis=0)
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(
        stacked / scale, np.concatenate([target.real, target.imag]), rcond=None
    )[0]
    return solution / scale
