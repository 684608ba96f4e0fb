# SPDX-License-Identifier: BSD-3-Clause
"""Poles that all axes share, by vector fitting in the z plane."""

from collections.abc import Sequence

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.axes.spectra import Spectrum
from piezo_identification.estimators.poles.vector_fitting import (
    FIRST_DAMPING,
    mode_basis,
    real_form,
)

ITERATIONS = 10
"""Relocations of the poles; those of the sharp ones stand still after four or five."""

TAPS = 2
"""Taps of the direct part. With the voltage of the same sample and of the one before, a delay of
less than a sample period is exact (Franklin, Powell and Workman 1998, section 4.3.4)."""

LEAST_STEP = 1e-3
"""Least real pole: what decays faster than to a thousandth in a sample is the direct part."""


def _slope_of_pole(z: ComplexArray, step: complex) -> ComplexArray:
    """Return the derivative of the response of a pole by its logarithm."""
    return step / (z - step) ** 2


def slopes_of_basis(z: ComplexArray, steps: ComplexArray) -> ComplexArray:
    """Return the derivatives of `mode_basis`, (numbers, K, columns).

    The numbers are, of each pair, the real and the imaginary part of the pole's logarithm, and of
    each real pole its logarithm.
    """
    pairs, real = steps[steps.imag > 0.0], steps[steps.imag == 0.0]
    columns = 2 * pairs.size + real.size
    slopes = np.zeros((columns, z.size, columns), dtype=complex)
    for at, step in enumerate(pairs):
        upper, lower = (_slope_of_pole(z, each) for each in (step, step.conj()))
        total, difference = upper + lower, 1j * (upper - lower)
        slopes[2 * at, :, 2 * at], slopes[2 * at, :, 2 * at + 1] = total, difference
        slopes[2 * at + 1, :, 2 * at], slopes[2 * at + 1, :, 2 * at + 1] = difference, -total
    for at, step in enumerate(real, start=2 * pairs.size):
        slopes[at, :, at] = _slope_of_pole(z, step)
    return slopes


def delays(z: ComplexArray, taps: int) -> ComplexArray:
    """Return the responses of a direct part to the present voltage and past ones, (K, taps)."""
    return z[:, None] ** -np.arange(taps)


def relocated(spectra: Sequence[Spectrum], pairs: int, steps: ComplexArray | None = None,
              iterations: int = ITERATIONS) -> ComplexArray:
    """Return poles in the z plane that all motions share (Gustavsen and Semlyen 1999), (m,).

    Some pairs may turn out as two real poles. By default the initial poles are spread over the
    lines. The poles are stable; pairs, by their upper pole, come before real ones.
    """
    if steps is None:
        angles = np.quantile(np.angle(spectra[0].z), np.linspace(0.0, 1.0, pairs + 2)[1:-1])
        steps = np.exp((1j - FIRST_DAMPING) * angles)
    for _ in range(iterations):
        conditions = [_condition(group, output, steps)
                      for group in _groups(spectra) for output in range(spectra[0].motion.shape[1])]
        rows, targets = (np.concatenate(each) for each in zip(*conditions, strict=True))
        scale = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
        common = np.linalg.lstsq(rows / scale, targets, rcond=None)[0] / scale
        dynamics, drive = real_form(steps)
        steps = _stable(np.linalg.eigvals(dynamics - np.outer(drive, common)).astype(complex))
    return steps


def _groups(spectra: Sequence[Spectrum]) -> list[list[Spectrum]]:
    """Return spectra in groups that have no driven axis in common: their gains are other ones."""
    groups: list[list[Spectrum]] = []
    for spectrum in spectra:
        meets = [any(set(each.driven) & set(spectrum.driven) for each in group)
                 for group in groups]
        together = [each for group, met in zip(groups, meets, strict=True) if met for each in group]
        groups = [group for group, met in zip(groups, meets, strict=True) if not met]
        groups.append([*together, spectrum])
    return groups


def _condition(group: Sequence[Spectrum], output: int,
               steps: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return what one motion says of the common numerator once its own gains are eliminated."""
    driven = sorted({axis for each in group for axis in each.driven})
    parts = []
    for spectrum in group:
        basis = mode_basis(spectrum.z, steps)
        gains = np.hstack([basis, delays(spectrum.z, TAPS)])
        motion = spectrum.motion[:, output, None]
        columns = [gains * spectrum.drive[:, axis, None] for axis in driven]
        columns += [-motion * basis, motion]
        # Each recording has its own transient: eliminating it here is far cheaper than together.
        transient = [transient_basis(spectrum, steps)] * spectrum.transient
        parts.append(_eliminated(
            sum(each.shape[1] for each in transient),
            spectrum.weight[:, output, None] * np.hstack([*transient, *columns])))
    rest = _eliminated(len(driven) * gains.shape[1], np.concatenate(parts))
    return rest[:-1, :-1], rest[:-1, -1]


def _eliminated(count: int, equations: ComplexArray | FloatArray) -> FloatArray:
    """Return what least-squares equations say of their last columns without the first ones."""
    if np.iscomplexobj(equations):
        equations = np.concatenate([equations.real, equations.imag])
    triangle: FloatArray = np.asarray(np.linalg.qr(equations, mode="r"))
    return triangle[count:, count:]


def transient_basis(spectrum: Spectrum, steps: ComplexArray) -> ComplexArray:
    """Return the spectra of the transients at both ends of a recording."""
    z = spectrum.z
    return np.hstack([mode_basis(z, steps), z[:, None] ** np.arange(spectrum.ahead + 1)])


def _stable(found: ComplexArray) -> ComplexArray:
    """Return poles within the unit circle; one that alternates turns into one that decays."""
    inside = np.where(np.abs(found) < 1.0, found, 1.0 / found.conj())
    pairs = inside[inside.imag > 0.0]
    real = np.maximum(np.abs(inside[inside.imag == 0.0].real), LEAST_STEP)
    return np.concatenate([pairs, real.astype(complex)])
