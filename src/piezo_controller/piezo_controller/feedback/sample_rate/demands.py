# SPDX-License-Identifier: BSD-3-Clause
"""What a feedback at the sample clock's rate is to reach, and what bounds it."""

from dataclasses import dataclass

import numpy as np

from piezo_controller.feedback.sample_rate.perturbed_loops import (
    COARSE,
    LoopFigures,
    ModelErrors,
    PerturbedLoops,
)
from piezo_models.cascade import StageModel


@dataclass(frozen=True)
class Demands:
    """What a loop is to reach, and what bounds it.

    Attributes
    ----------
    bandwidth_ratio : float
        Of the closed loop at -3 dB to the frequency of the first mode.
    sensor_noise_um : float
        White at the sample clock's rate, root mean square.
    added_noise_um : float
        Largest displacement that it may cause.
    noise_voltage_v : float
        Largest voltage that it may cause: six of them stay below the 4 V from which on the stage
        takes a growing swing for an oscillation.
    worst_peak_sensitivity : float
        Largest peak over all stages: the robustness at which designs are compared.
    slow_sensitivity : float
        Largest sensitivity below half the lowest disturbance, over all stages: at most 1, so that
        no slow error grows.
    disturbance_tolerance : float
        Relative error of the frequencies of the disturbances, over which they are attenuated: 1 %,
        within which the mains' frequency lies.
    of_every_stage : bool
        Whether every stage that the errors allow is to reach it, or the model itself.
    """

    bandwidth_ratio: float = 1.2
    disturbance_hz: tuple[float, ...] = (50.0, 100.0)
    attenuation_db: tuple[float, ...] = (30.0, 20.0)
    sensor_noise_um: float = 0.009
    added_noise_um: float = 0.009
    noise_voltage_v: float = 0.5
    worst_peak_sensitivity: float = 4.0
    slow_sensitivity: float = 1.0
    errors: ModelErrors = ModelErrors()
    disturbance_tolerance: float = 0.01
    of_every_stage: bool = False

    def loops(self, model: StageModel, clock_period_s: float,
              delay_ticks: int = 0, coarse: int = COARSE) -> PerturbedLoops:
        """Return the stages of a model that are to meet the demands; see `PerturbedLoops`."""
        return PerturbedLoops(model, self.errors, clock_period_s, self.disturbance_hz,
                              self.disturbance_tolerance, delay_ticks, coarse)

    def margin_db(self, figures: LoopFigures, first_mode_hz: float) -> float:
        """Return by how much the least margin exceeds what is asked; negative if it does not."""
        bandwidth_hz, attenuation_db = (
            (figures.worst_bandwidth_hz, figures.worst_attenuation_db) if self.of_every_stage
            else (figures.bandwidth_hz, figures.attenuation_db))
        bandwidth_db = _decibels(bandwidth_hz / (self.bandwidth_ratio * first_mode_hz))
        return min(bandwidth_db, *(reached - asked for reached, asked in zip(
            attenuation_db, self.attenuation_db, strict=True)))

    def violation_db(self, figures: LoopFigures) -> float:
        """Return by how much the bounds are exceeded; 0 if they are kept."""
        if figures.unstable:
            return 40.0 + figures.unstable + 1e3 * (figures.largest_pole - 1.0)
        noise_um = self.sensor_noise_um
        return sum(max(0.0, _decibels(value)) for value in (
            figures.worst_peak_sensitivity / self.worst_peak_sensitivity,
            figures.worst_slow_sensitivity / self.slow_sensitivity,
            noise_um * figures.noise_gain / self.added_noise_um,
            noise_um * figures.noise_gain_v_per_um / self.noise_voltage_v))


def _decibels(ratio: float) -> float:
    return float(20 * np.log10(max(ratio, 1e-9)))
