# SPDX-License-Identifier: BSD-3-Clause
"""Sensitivities of the displacement to the parameters of the model."""


from functools import lru_cache

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

MIDDLE_KNOTS, SPAN_KNOTS = 4, 8
"""Knots of the bilinear surface that multiplies the density."""


def sensitivity_systems(
    creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
) -> list[control.StateSpace]:
    """Return systems from the displacement to its derivatives by the logarithms of parameters.

    Each is the derivative of a factor of the transfer function by one of its parameters, divided
    by the factor.

    Returns
    -------
    list of control.StateSpace
        Systems for the creep poles, creep zeros, time constant unless it is 0, mode frequencies,
        damping ratios, and those of the antiresonances.
    """
    def first_order(rate: float, gain: float, direct: float = 0.0) -> control.StateSpace:
        return control.ss([[-rate]], [[rate]], [[gain]], [[direct]])

    def second_order(
        frequency: float, damping: float, position: float, velocity: float, direct: float,
    ) -> control.StateSpace:
        return control.ss(
            [[0.0, frequency], [-frequency, -2.0 * damping * frequency]], [[0.0], [frequency]],
            [[position, velocity]], [[direct]],
        )

    systems = [first_order(pole, -1.0) for pole in creep.poles_rad_per_s]
    systems += [first_order(zero, 1.0) for zero in creep.zeros_rad_per_s]
    if dynamics.time_constant_s > 0.0:
        systems.append(first_order(1.0 / dynamics.time_constant_s, 1.0, -1.0))
    for frequencies, dampings, sign in (
        (dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, 1.0),
        (dynamics.antiresonance_frequencies_rad_per_s, dynamics.antiresonance_damping_ratios, -1.0),
    ):
        pairs = list(zip(frequencies, dampings, strict=True))
        systems += [
            second_order(w, d, -2.0 * sign, -2.0 * sign * d, 2.0 * sign) for w, d in pairs
        ]
        systems += [second_order(w, d, 0.0, -2.0 * sign * d, 0.0) for w, d in pairs]
    return systems


@lru_cache(maxsize=4)
def factor_surfaces(
    size: int, middle_knots: int = MIDDLE_KNOTS, span_knots: int = SPAN_KNOTS,
) -> FloatArray:
    """Return surfaces over the cells of a density that sum to one.

    They are bilinear between knots in the mean of the thresholds and in the square root of their
    span: a density changes fastest near the diagonal, where the knots are closest.

    Parameters
    ----------
    size : int
        Number of cells along each threshold.

    Returns
    -------
    ndarray, shape (surfaces, size, size)
        Lower triangular.
    """
    alpha, beta = np.indices((size, size))
    # A cell on the diagonal is a triangle, whose centroid is off the diagonal.
    span = np.where(alpha == beta, 1.0 / 3.0, alpha - beta) / size

    surfaces = [
        np.tril(middle_hat * span_hat)
        for middle_hat in _hats(0.5 * (alpha + beta + 1) / size, middle_knots)
        for span_hat in _hats(np.sqrt(np.maximum(span, 0.0)), span_knots)
    ]
    return np.array([surface for surface in surfaces if surface.any()])


def _hats(position: FloatArray, knots: int) -> list[FloatArray]:
    """Return piecewise linear functions of a position from 0 to 1 that sum to one."""
    return [np.maximum(0.0, 1.0 - np.abs(position * (knots - 1) - knot)) for knot in range(knots)]
