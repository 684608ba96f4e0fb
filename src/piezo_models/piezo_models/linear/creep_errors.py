# SPDX-License-Identifier: BSD-3-Clause
"""Correlation of the errors of a creep model: rate and size of each pair of pole and zero."""

import numpy as np

from piezo_models.linear.dynamics import CreepDynamics


def creep_error_map(creep: CreepDynamics) -> np.ndarray:
    """Return the matrix from relative errors of creep to errors of log poles and log zeros.

    Pole and zero of a pair lie so close that they cannot be determined separately: an error of a
    few percent in one alone would reverse the sign of the creep. The independent quantities are
    their common rate and the size of the pair, zero - pole. Of P pairs, the columns of the matrix,
    (2 P, 2 P), are errors of the rates, then of the sizes; the rows are errors of the logarithms of
    the poles, then of the zeros.
    """
    poles, zeros = np.array(creep.poles_rad_per_s), np.array(creep.zeros_rad_per_s)
    identity = np.eye(poles.size)
    by_size = np.diag((zeros - poles) / zeros) if poles.size else identity
    return np.block([[identity, 0.0 * identity], [identity, by_size]])


def with_creep_errors(creep: CreepDynamics, errors: np.ndarray) -> CreepDynamics:
    """Return the creep with relative errors of the pairs' rates, then of their sizes, (2 P,)."""
    changes = np.exp(creep_error_map(creep) @ errors)
    by_pole, by_zero = np.split(changes, 2)
    return CreepDynamics(tuple(creep.poles_rad_per_s * by_pole),
                         tuple(creep.zeros_rad_per_s * by_zero))
