# SPDX-License-Identifier: BSD-3-Clause
"""Nuisance parameters of a recording for any model: its offset and its initial creep."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_models.cascade import StageModel

if TYPE_CHECKING:
    from piezo_identification.simulation.simulated_recording import SimulatedRecording


def offset_and_decays(model: StageModel, time_s: FloatArray) -> FloatArray:
    """Return the regressors of offset and initial creep at some times, (n, 1 + creep pairs)."""
    return np.column_stack([np.exp(-rate * time_s) for rate in _nuisance_rates(model)])


def nuisance_regressors(part: "SimulatedRecording", rows: NDArray[np.intp]) -> FloatArray:
    """Return the regressors of offset and initial creep at some samples, (n, 1 + creep pairs)."""
    return offset_and_decays(part.model, part.time_s[rows])


def nuisance_signal(part: "SimulatedRecording", sizes: FloatArray) -> FloatArray:
    """Return the sum of the nuisance regressors times their sizes at all samples, (N,).

    Parameters
    ----------
    sizes : (1 + creep pairs,) array
    """
    summed = np.zeros(part.time_s.size)
    for size, rate in zip(sizes, _nuisance_rates(part.model), strict=True):
        summed += size * np.exp(-rate * part.time_s)
    return summed


def _nuisance_rates(model: StageModel) -> list[float]:
    """Return the decay rates of the nuisance regressors in rad/s; that of the offset is 0."""
    rates = [0.0, *model.creep.poles_rad_per_s]
    if model.hysteretic_creep is not None:
        rates += [1.0 / tau for tau in set(model.hysteretic_creep.time_constants_s)]
    return rates
