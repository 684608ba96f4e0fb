# SPDX-License-Identifier: BSD-3-Clause
"""Rational fit of a frequency response by vector fitting."""

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray


def vector_fit(
    frequency_rad_per_s: FloatArray, gain: ComplexArray, pole_count: int, iterations: int = 20,
    weight: FloatArray | float = 1.0,
) -> ComplexArray:
    """Poles of a proper rational function near a measured response.

    The poles are relocated by linear regressions (Gustavsen and Semlyen, "Rational approximation
    of frequency domain responses by vector fitting", 1999), so that no starting guess is needed.

    Parameters
    ----------
    frequency_rad_per_s : ndarray, shape (N,)
        Positive.
    gain : ndarray of complex, shape (N,)
    weight : float or ndarray, shape (N,)
        Of each frequency's error.

    Returns
    -------
    ndarray of complex, shape (pole_count,)
        In rad/s; stable.

    Raises
    ------
    ValueError
        If there are too few frequencies.
    """
    if frequency_rad_per_s.size <= pole_count:
        raise ValueError(
            f"{frequency_rad_per_s.size} frequencies are too few for {pole_count} poles: measure "
            "more or ask for a lower order"
        )
    scale = frequency_rad_per_s.max()
    s = 1j * frequency_rad_per_s / scale
    # Spread as the measured frequencies are.
    ranks = np.linspace(0.0, 1.0, pole_count // 2 + 2)[1:-1]
    pairs = np.quantile(frequency_rad_per_s, ranks) / scale
    poles = np.concatenate([(-0.02 + 1j) * pairs, (-0.02 - 1j) * pairs])
    if pole_count % 2:
        poles = np.append(poles, -0.1)
    for _ in range(iterations):
        dynamics, drive, basis = _basis(s, poles)
        columns = np.column_stack([basis, np.ones_like(s), -gain[:, None] * basis])
        solution = _real_lstsq(weight, columns, gain)
        poles = np.linalg.eigvals(dynamics - np.outer(drive, solution[pole_count + 1 :]))
        poles = -np.maximum(np.abs(poles.real), 1e-9) + 1j * poles.imag
    return poles * scale


def left_by_poles(
    frequency_rad_per_s: FloatArray, gain: ComplexArray, poles: ComplexArray,
    weight: FloatArray | float = 1.0,
) -> ComplexArray:
    """Return what the best rational function with given poles leaves of a response, shape (N,).

    Parameters
    ----------
    frequency_rad_per_s : ndarray, shape (N,)
    gain : ndarray of complex, shape (N,)
    poles : ndarray of complex, shape (n,)
        In rad/s, closed under conjugation.
    weight : float or ndarray, shape (N,)
    """
    scale = frequency_rad_per_s.max()
    basis = _basis(1j * frequency_rad_per_s / scale, poles / scale)[2]
    columns = np.column_stack([basis, np.ones(basis.shape[0])])
    return gain - columns @ _real_lstsq(weight, columns, gain)


def _basis(s: ComplexArray, poles: ComplexArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Real state space with these poles, and its states' responses (N, n)."""
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
