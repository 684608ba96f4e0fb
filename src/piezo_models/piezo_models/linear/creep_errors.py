# SPDX-License-Identifier: BSD-3-Clause
"""How errors of a creep model go together: where a pair lies, and how much it creeps."""

import numpy as np

from piezo_models.linear.dynamics import CreepDynamics


def creep_error_map(creep: CreepDynamics) -> np.ndarray:
    """Turn relative errors of creep into errors of the logarithms of its poles and zeros.

    Pole and zero of a pair lie so close that they are not known apart: an error of a few percent in
    each alone would turn creep that goes on into creep that recedes. What is known with an error is
    their common rate, and the size of the pair, zero - pole.

    Parameters
    ----------
    creep : CreepDynamics
        With P pairs.

    Returns
    -------
    ndarray, shape (2 P, 2 P)
        For the errors of the rates, then of the sizes: the errors of the logarithms of the poles,
        then of the zeros.
    """
    poles, zeros = np.array(creep.poles_rad_per_s), np.array(creep.zeros_rad_per_s)
    identity = np.eye(poles.size)
    by_size = np.diag((zeros - poles) / zeros) if poles.size else identity
    return np.block([[identity, 0.0 * identity], [identity, by_size]])


def with_creep_errors(creep: CreepDynamics, errors: np.ndarray) -> CreepDynamics:
    """Return the creep with relative errors of rates and sizes.

    Parameters
    ----------
    errors : ndarray, shape (2 P,)
        Of the pairs' rates, then of their sizes.
    """
    changes = np.exp(creep_error_map(creep) @ errors)
    by_pole, by_zero = np.split(changes, 2)
    return CreepDynamics(tuple(creep.poles_rad_per_s * by_pole),
                         tuple(creep.zeros_rad_per_s * by_zero))
