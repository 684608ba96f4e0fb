# SPDX-License-Identifier: BSD-3-Clause
"""Errors of the model in each recording, from which effects derive initial guesses."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.nonnegative_regression import nonnegative_least_squares
from piezo_identification.fitting.regression import Regression
from piezo_models.effects import Effect, Evidence


def recording_evidence(regression: Regression, effects: Sequence[Effect] = ()) -> list[Evidence]:
    """Return the errors of each recording with some effects in the model."""
    return [_of_recording(regression, index, mask, effects)
            for index, mask in enumerate(regression.dataset.masks())]


def _of_recording(regression: Regression, index: int, mask: BoolArray,
                  effects: Sequence[Effect]) -> Evidence:
    dataset = regression.dataset
    part, used = dataset.simulated[index], regression.estimation[mask]
    tolerance_um = regression.tolerance_um[mask][0]
    simulated_um = part.simulate(effects)
    return Evidence(
        part.sample_period_s, part.voltage_v, simulated_um,
        residual_um(dataset, index, effects, regression.noise),
        regression.noise.noise_um[index], dataset.model.dynamics, part.drive_um,
        *_projections(dataset.regressors[mask][used] / tolerance_um, regression.prior,
                      dataset.rows[index][used], tolerance_um, part.measured_um - simulated_um),
        part.measured_um,
    )


def _projections(
    regressors: FloatArray, prior: FloatArray, rows: NDArray[np.intp], tolerance_um: float,
    difference_um: FloatArray,
) -> tuple[Callable[..., tuple[FloatArray, float]], Callable[[FloatArray], float]]:
    """Return functions for the error that contributions explain, and for their visibility."""
    q, _ = np.linalg.qr(np.vstack([regressors, prior]))

    def project(values: FloatArray) -> FloatArray:
        zeros = np.zeros((len(prior), values.shape[1]))
        padded = np.vstack([values[rows] / tolerance_um, zeros])
        return padded - q @ (q.T @ padded)

    residual = project(difference_um[:, None])[:, 0]
    energy = residual @ residual

    def reduction(contributions: FloatArray,
                  positive: bool = False) -> tuple[FloatArray, float]:
        seen = project(contributions)
        if positive:
            triangle = qr(np.column_stack([seen, residual]), mode="r")[0]
            gains = nonnegative_least_squares(triangle[:, :-1], triangle[:, -1])[0]
        else:
            gains = np.linalg.lstsq(seen, residual, rcond=1e-10)[0].astype(float)
        rest = residual - seen @ gains
        return np.asarray(gains, dtype=float), float(1.0 - (rest @ rest) / energy)

    def visible(contribution: FloatArray) -> float:
        varying = (contribution[rows] - contribution[rows].mean()) / tolerance_um
        whole = float(np.linalg.norm(varying))
        return float(np.linalg.norm(project(contribution))) / max(whole, 1e-300)

    return reduction, visible
