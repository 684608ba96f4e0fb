# SPDX-License-Identifier: BSD-3-Clause
"""Preisach density from a recording: the linear dynamics removed, then the estimate."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.settling import first_settled, low_frequency_delay_s
from piezo_identification.conditioning.waveforms import played, sample_by_voltage
from piezo_identification.estimators.dynamics.square_wave import remove_creep
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording


def estimate_hysteresis(
    recording: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    level_count: int = 70, cells_per_level: int = 2, smoothing_weight: float | None = None,
) -> PreisachModel:
    """Estimate the hysteresis: the model of `estimate_density`, which describes the parameters.

    Returns
    -------
    PreisachModel

    Raises
    ------
    ValueError
        As `estimate_density`.
    """
    return estimate_density(
        recording, creep, dynamics, level_count, cells_per_level, smoothing_weight
    ).model()


def estimate_density(
    recording: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    level_count: int = 70, cells_per_level: int = 2, smoothing_weight: float | None = None,
    translation_weight: float = 0.0, delay_s: float = 0.0,
) -> DensityEstimate:
    """Estimate the Preisach density on a uniform grid over the voltages played.

    Creep and fast dynamics are removed by their inverses, Fig. 4.8. What is left makes a linear
    regression (4.11), solved by smoothed non-negative least squares with all samples; offset and
    initial creep are free. Any input will do: `DensityEstimate.visited` tells which part of the
    plane it determines.

    Parameters
    ----------
    recording : Recording
        Of the hysteresis experiment, or any slow one. For the start see `everett_regression`.
        Samples that are marked as outliers are neither fitted nor held out.
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
    level_count : int
        Number of levels L above level 0.
    cells_per_level : int
        Cells of the model from one level to the next.
    smoothing_weight : float, optional
        By default chosen on held-out samples, see `smoothed_density`.
    translation_weight : float
        Of `smoothed_density`; for inputs that leave much of the plane unvisited.
    delay_s : float
        Of the measurement, beside the dynamics.

    Returns
    -------
    DensityEstimate

    Raises
    ------
    ValueError
        If the recording has gaps, its voltage does not pass by all levels, or the displacement
        falls where the voltage rises.
    """
    part = played(recording)
    voltage_v = part.voltage_v
    levels_v = np.linspace(voltage_v.min(), voltage_v.max(), level_count + 1)
    _check_coverage(recording.path, part, levels_v)
    settled = np.arange(part.time_s.size) >= first_settled(dynamics, part.time_s)
    edges_v = np.linspace(levels_v[0], levels_v[-1], level_count * cells_per_level + 1)
    return smoothed_density(
        voltage_v, hysteresis_output_um(part, creep, dynamics, delay_s), edges_v,
        samples=np.flatnonzero(settled & good_samples(part)),
        transients=np.exp(-np.outer(part.time_s, creep.zeros_rad_per_s)),
        smoothing_weight=smoothing_weight, level_count=level_count,
        translation_weight=translation_weight,
    )


def hysteresis_output_um(
    recording: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    delay_s: float = 0.0,
) -> FloatArray:
    """Hysteresis output at each sample: creep, electric and vibration dynamics removed.

    Parameters
    ----------
    recording : Recording
        Of a voltage that is slow beside the electric and vibration dynamics.
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
        Inverted at low frequency, (4.18) and (4.19).
    delay_s : float
        Further delay.

    Returns
    -------
    ndarray, shape (N,)
        But for the decaying trace of the creep's initial state.
    """
    displacement_um = recording.displacement_um
    if dynamics.is_static and delay_s == 0.0:
        return remove_creep(displacement_um, creep, recording.sample_period_s)
    # The hold lags half a sample, the mean leads half a sample less half a clock period.
    lead_s = delay_s + low_frequency_delay_s(dynamics) + 0.5 / recording.sample_rate_hz
    slope_um_per_s = np.gradient(displacement_um, recording.sample_period_s)
    return remove_creep(displacement_um + lead_s * slope_um_per_s, creep, recording.sample_period_s)


def _check_coverage(path: str, part: Recording, levels_v: FloatArray) -> None:
    """Refuse a voltage that jumps over the levels, and a displacement of the wrong sign."""
    samples = sample_by_voltage(part.voltage_v, levels_v)
    spacing_v = levels_v[1] - levels_v[0]
    passed = np.unique(np.round((part.voltage_v[samples] - levels_v[0]) / max(spacing_v, 1e-12)))
    if passed.size < 0.9 * levels_v.size:
        raise ValueError(
            f"{path} passes by {passed.size} of {levels_v.size} voltage levels: "
            "give a hysteresis experiment, whose voltage changes slowly"
        )
    rise_um = np.polyfit(part.voltage_v[samples], part.displacement_um[samples], 1)[0]
    if rise_um <= 0.0:
        raise ValueError(
            f"{path}: the displacement falls where the voltage rises: reverse the sign of one"
        )
