# SPDX-License-Identifier: BSD-3-Clause
"""The residual of linear dynamics for a generator whose edges lie between the samples."""

import control
import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.generator_edges import GeneratorEdges
from piezo_identification.estimators.dynamics.generator_signals import (
    ROUNDS,
    edge_responses,
    moved_edges,
)
from piezo_identification.estimators.poles.pole_responses import HeldInput


def generator_residual_um(
    system: control.StateSpace, held: HeldInput, delay_s: float, edges: GeneratorEdges,
    measured_um: FloatArray, nuisance: FloatArray, good: BoolArray,
) -> FloatArray:
    """Return the residual of a system with the best-fitting gain and edge times.

    The samples determine period, duty and time of the edges only to within a sample period.

    Parameters
    ----------
    system : control.StateSpace
        Continuous system without direct feedthrough.
    held : HeldInput
        The N sampled levels.
    measured_um : ndarray, shape (K,)
        Measured displacement of the last K samples.
    nuisance : ndarray, shape (N, M)
        Further regressors, such as offset and initial creep.
    good : ndarray of bool, shape (K,)
        True for samples that are fitted.

    Returns
    -------
    ndarray, shape (K,)
        Residual in um.
    """
    poles, vectors = np.linalg.eig(system.A)
    residues = (system.C @ vectors)[0] * np.linalg.solve(vectors, system.B)[:, 0]
    delay = delay_s / held.sample_period_s
    last = slice(held.samples.size - measured_um.size, None)
    held = moved_edges(held, edges.early)

    def fitted(*moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        response = (held.responses(poles, delay).value @ residues).real
        columns = np.column_stack([response, *moved, nuisance])[last]
        weights = np.linalg.lstsq(columns[good], measured_um[good], rcond=1e-12)[0]
        return weights, np.asarray(measured_um - columns @ weights)

    for _ in range(ROUNDS):
        moved = edge_responses(held, edges.directions, poles, residues, delay)
        weights = fitted(moved)[0]
        by = weights[1 : 1 + moved.shape[1]] / weights[0]
        held = moved_edges(held, edges.directions @ by)
    return fitted()[1]
