# SPDX-License-Identifier: BSD-3-Clause
"""The Preisach plane as a grid of relays: the linear regression of the density, and plain relays.

Cells are ordered row by row, i-major with j <= i, as in `numpy.tril_indices(L)`.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.hysteresis.preisach_kernels import branch_start, with_room


def activation_matrix(voltage_v: ArrayLike, levels_v: ArrayLike,
                      samples: ArrayLike | None = None) -> FloatArray:
    """Return the active area of every cell of the Preisach plane, from negative saturation on.

    With `mu = density[numpy.tril_indices(L)]`, the output of the hysteresis is exactly
    `activation_matrix(...) @ mu + offset`: eq. (2.3) with true areas in place of whole cells, as
    the staircase may cross a cell anywhere.

    The levels, (L + 1,), are the increasing edges of the cells; voltages, (N,), beyond them act as
    the outermost level. The result, (N, L(L + 1)/2), holds areas in V^2. If increasing indices of
    voltages are given as `samples`, (M,), only their rows are returned, (M, L(L + 1)/2); the
    voltages between them act, too.

    Raise ValueError if the levels do not increase, a voltage is not finite, or the samples do not
    increase within the sequence.
    """
    voltage = np.ascontiguousarray(voltage_v, dtype=float)
    levels = np.ascontiguousarray(levels_v, dtype=float)
    if levels.ndim != 1 or levels.size < 2 or not (np.diff(levels) > 0).all():
        raise ValueError("levels_v must hold at least two increasing voltages")
    if voltage.ndim != 1 or not np.isfinite(voltage).all():
        raise ValueError("voltage_v must be one sequence of finite voltages")
    if samples is None:
        samples = np.arange(voltage.size)
    samples = np.ascontiguousarray(samples, dtype=np.int64)
    if samples.size and (
        samples[0] < 0 or samples[-1] >= voltage.size or not (np.diff(samples) > 0).all()
    ):
        raise ValueError(f"samples must increase within 0 to {voltage.size - 1}")
    return _activation_matrix(voltage, levels, samples)


@njit(cache=True)
def _activation_matrix(voltage: FloatArray, levels: FloatArray,
                       samples: NDArray[np.int64]) -> FloatArray:
    size = levels.size - 1
    areas = np.zeros((samples.size, size * (size + 1) // 2))
    extremes = np.empty(16)
    extremes[0] = levels[0]
    top = 0
    row = 0
    for n in range(voltage.size):
        v = min(max(voltage[n], levels[0]), levels[-1])
        if v != extremes[top]:
            top = branch_start(extremes, top, v) + 1
            extremes = with_room(extremes, top)
            extremes[top] = v
        if row < samples.size and samples[row] == n:
            # Relays with beta between two successive minima are on up to the maximum between them.
            for k in range(1, top + 1, 2):
                lower = extremes[k - 1]
                upper = extremes[k + 1] if k < top else v
                _add_strip(areas[row], levels, lower, upper, extremes[k])
            row += 1
    return areas


@njit(cache=True)
def _add_strip(areas: FloatArray, levels: FloatArray, beta_low: float, beta_high: float,
               alpha_high: float) -> None:
    """Add the area with beta_low < beta < beta_high and beta < alpha < alpha_high, cell by cell."""
    size = levels.size - 1
    for j in range(size):
        low = max(beta_low, levels[j])
        high = min(beta_high, levels[j + 1])
        if low >= high:
            continue
        diagonal_top = min(alpha_high, levels[j + 1])
        areas[j * (j + 1) // 2 + j] += (high - low) * (diagonal_top - (low + high) / 2)
        for i in range(j + 1, size):
            if alpha_high <= levels[i]:
                break
            height = min(alpha_high, levels[i + 1]) - levels[i]
            areas[i * (i + 1) // 2 + j] += (high - low) * height


def cell_centre_relays(model: PreisachModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return relays at the cell centres of a model, each with the weight of its cell, eq. (2.2).

    They are alpha (V), beta (V) and weight (um), (L(L + 1)/2,) each.
    """
    i, j = np.tril_indices(model.density_um_per_v2.shape[0])
    centres = (model.levels_v[:-1] + model.levels_v[1:]) / 2
    areas = np.where(i == j, 0.5, 1.0) * model.cell_width_v**2
    weights = model.density_um_per_v2[i, j] * areas
    weights[i == j] += model.reversible_um_per_v * model.cell_width_v
    return centres[i], centres[j], weights


def simulate_relays(voltage_v: ArrayLike, alpha_v: ArrayLike, beta_v: ArrayLike,
                    weight_um: ArrayLike, offset_um: float = 0.0) -> FloatArray:
    """Return the sum (um), (N,), of weighted relays, (R,), by updating each of them at each sample.

    A relay switches on when the voltage reaches its alpha and off when it falls below its beta; all
    are off at the start, where the output is the offset.
    """
    voltage, alpha, beta, weight = (
        np.ascontiguousarray(x, dtype=float) for x in (voltage_v, alpha_v, beta_v, weight_um))
    return _simulate_relays(voltage, alpha, beta, weight, float(offset_um))


@njit(cache=True)
def _simulate_relays(voltage: FloatArray, alpha: FloatArray, beta: FloatArray, weight: FloatArray,
                     offset: float) -> FloatArray:
    output = np.empty(voltage.size)
    on = np.zeros(alpha.size, dtype=np.bool_)
    for n in range(voltage.size):
        total = offset
        for r in range(alpha.size):
            if voltage[n] >= alpha[r]:
                on[r] = True
            elif voltage[n] < beta[r]:
                on[r] = False
            if on[r]:
                total += weight[r]
        output[n] = total
    return output
