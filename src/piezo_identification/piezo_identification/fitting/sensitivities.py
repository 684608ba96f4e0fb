# SPDX-License-Identifier: BSD-3-Clause
"""How the displacement depends on each parameter of the model."""


from functools import lru_cache

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

MIDDLE_KNOTS, SPAN_KNOTS = 4, 8
"""Between which the surface that multiplies the density is bilinear."""


def sensitivity_systems(
    creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
) -> list[control.StateSpace]:
    """Systems that turn the displacement into its derivatives by the logarithms of parameters.

    The derivative of a factor of the transfer function by one of its parameters, over the factor.

    Returns
    -------
    list of control.StateSpace
        Creep poles, creep zeros, time constant unless it is 0, mode frequencies, damping ratios,
        and those of the antiresonances.
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
    """Surfaces over the cells of a density that sum to one.

    They are bilinear between knots in the middle of the thresholds and in the root of their span:
    a density changes fastest near the diagonal, where the knots lie close.

    Parameters
    ----------
    size : int
        Cells along each threshold.

    Returns
    -------
    ndarray, shape (surfaces, size, size)
        Lower triangular.
    """
    alpha, beta = np.indices((size, size))
    # A cell on the diagonal is a triangle, whose centroid lies aside.
    span = np.where(alpha == beta, 1.0 / 3.0, alpha - beta) / size

    surfaces = [
        np.tril(middle_hat * span_hat)
        for middle_hat in _hats(0.5 * (alpha + beta + 1) / size, middle_knots)
        for span_hat in _hats(np.sqrt(np.maximum(span, 0.0)), span_knots)
    ]
    return np.array([surface for surface in surfaces if surface.any()])


def _hats(position: FloatArray, knots: int) -> list[FloatArray]:
    """Functions of a position from 0 to 1, linear between knots, that sum to one."""
    return [np.maximum(0.0, 1.0 - np.abs(position * (knots - 1) - knot)) for knot in range(knots)]
