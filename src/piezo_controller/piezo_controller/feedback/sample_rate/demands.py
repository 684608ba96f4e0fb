# SPDX-License-Identifier: BSD-3-Clause
"""Requirements and bounds of a feedback at the rate of the sample clock."""

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
    """Requirements and bounds of a loop."""

    bandwidth_ratio: float = 1.2
    """Bandwidth of the closed loop at -3 dB over the frequency of the first mode."""
    disturbance_hz: tuple[float, ...] = (50.0, 100.0)
    attenuation_db: tuple[float, ...] = (30.0, 20.0)

    sensor_noise_um: float = 0.009
    """Root mean square of the sensor's noise, which is white at the rate of the sample clock."""
    added_noise_um: float = 0.009
    """Largest displacement that the noise may cause (um, rms)."""
    noise_voltage_v: float = 0.5
    """Largest voltage that the noise may cause (V, rms). Six times this is below the 4 V above
    which the stage takes a growing amplitude for an oscillation."""
    worst_peak_sensitivity: float = 4.0
    """Largest peak over all stages; designs are compared at this robustness."""
    slow_sensitivity: float = 1.0
    """Largest sensitivity below half the lowest disturbance, over all stages; at most 1, so that no
    slow error is amplified."""
    errors: ModelErrors = ModelErrors()

    disturbance_tolerance: float = 0.01
    """Relative error of the frequencies of the disturbances, over which they are attenuated; the
    mains' frequency stays within 1 %."""
    of_every_stage: bool = False
    """Whether all stages within the model's errors must meet the requirements, or only the
    model."""

    def loops(self, model: StageModel, clock_period_s: float,
              coarse: int = COARSE) -> PerturbedLoops:
        """Return the stages of a model that must meet the requirements; see `PerturbedLoops`."""
        return PerturbedLoops(model, self.errors, clock_period_s, self.disturbance_hz,
                              self.disturbance_tolerance, delay_ticks=0, coarse=coarse)

    def margin_db(self, figures: LoopFigures, first_mode_hz: float) -> float:
        """Return by how much the least margin exceeds the requirement; negative if it does not."""
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
