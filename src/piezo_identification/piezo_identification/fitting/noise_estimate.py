# SPDX-License-Identifier: BSD-3-Clause
"""The residual of each recording, and the noise and outliers estimated from it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.outlier_samples import outliers_of_residual
from piezo_identification.conditioning.sensor_noise import sensor_noise_um
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect

MOST_SAMPLES = 50_000
"""Largest number of samples used to fit the few nuisance regressors of one recording."""


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise and outliers of each recording, estimated with some effects in the model."""

    noise_um: tuple[float, ...]
    """Standard deviation of the sensor noise."""
    outliers: tuple[BoolArray, ...]
    """Samples that were marked before or that stand out in the residual."""


def estimate_noise(dataset: Dataset, effects: Sequence[Effect] = (),
                   before: NoiseEstimate | None = None) -> NoiseEstimate:
    """Estimate noise and outliers from the residual of the model with some effects.

    The outliers of an earlier estimate are excluded from the fit of the residual. Without one, only
    samples that were marked as outliers are excluded.
    """
    residuals = [residual_um(dataset, index, effects, before)
                 for index in range(len(dataset.simulated))]
    noise_um, outliers = [], []
    for part, residual in zip(dataset.simulated, residuals, strict=True):
        def standing_out(noise: float, part: SimulatedRecording = part,
                         residual: FloatArray = residual) -> BoolArray:
            return part.outlier | outliers_of_residual(
                residual, part.measured_um, part.voltage_v, noise)

        noise_um.append(sensor_noise_um(
            part.measured_um[part.begin :], part.voltage_v[part.begin :],
            np.where(standing_out(0.0), 0.0, residual)[part.begin :], part.repeated_period,
        ))
        outliers.append(standing_out(noise_um[-1]))
    return NoiseEstimate(tuple(noise_um), tuple(outliers))


def residual_um(dataset: Dataset, index: int, effects: Sequence[Effect] = (),
                noise: NoiseEstimate | None = None) -> FloatArray:
    """Return measured minus simulated displacement without its nuisance part, (N,).

    The outliers of the noise estimate are not fitted. Without one, only marked outliers are
    excluded.
    """
    return _without_nuisance(dataset.simulated[index], effects, _outliers(dataset, index, noise))


def residual_of_model_um(dataset: Dataset, index: int, model: StageModel,
                         noise: NoiseEstimate | None = None) -> FloatArray:
    """Return the residual of one recording with another model, (N,); see `residual_um`."""
    part = dataset.simulated[index].with_model(model)
    return _without_nuisance(part, (), _outliers(dataset, index, noise))


def _outliers(dataset: Dataset, index: int, noise: NoiseEstimate | None) -> BoolArray:
    return dataset.simulated[index].outlier if noise is None else noise.outliers[index]


def _without_nuisance(part: SimulatedRecording, effects: Sequence[Effect],
                      outlier: BoolArray) -> FloatArray:
    difference = part.measured_um - part.simulate(effects)
    every = np.arange(part.begin, part.time_s.size)
    step = max(1, every.size // MOST_SAMPLES)
    used = every[::step][~outlier[every[::step]]]
    nuisance = part.nuisance_regressors(np.arange(part.time_s.size), effects)
    sizes = np.linalg.lstsq(nuisance[used], difference[used], rcond=1e-12)[0]
    return difference - nuisance @ sizes
