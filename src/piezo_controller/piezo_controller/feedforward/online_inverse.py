# SPDX-License-Identifier: BSD-3-Clause
"""Inverse of a whole model that is computed chunk by chunk with bounded memory."""

from dataclasses import dataclass, replace

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.feasibility import Infeasible, check_hysteresis_range
from piezo_controller.feedforward.preview_inverse import PreviewInverse
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.hysteresis.preisach import PreisachMemory
from piezo_models.linear.dynamics import continue_linear

# Samples before and after a chunk that the compensation of an effect needs.
EFFECT_MARGIN_SAMPLES = 80


def compensated_effects(model: StageModel) -> tuple[Effect, ...]:
    """Return the effects that a stream compensates, in reverse order."""
    return tuple(effect for place in ("sensor", "displacement")
                 for effect in reversed(model.effects_at(place)) if effect.follows_voltage)


@dataclass
class OnlineInverse:
    """Inverse of a model, with its state: displacements in, voltages out.

    The dynamics are inverted by a filter with preview, the slow creep by its causal inverse, and
    the hysteresis exactly. The states of all three are carried from chunk to chunk.
    """

    model: StageModel
    preview: PreviewInverse
    creep_inverse: control.StateSpace
    sample_period_s: float
    preview_state: FloatArray
    creep_state: FloatArray
    hysteresis: PreisachMemory
    window_um: FloatArray

    def copy(self) -> "OnlineInverse":
        """Return a copy with an independent state."""
        return replace(self, hysteresis=self.hysteresis.copy())

    def look_ahead(self, displacement_um: FloatArray) -> None:
        """Take the first displacements, before any voltage can be computed."""
        self._before_dynamics(displacement_um)

    def continue_with(self, displacement_um: FloatArray) -> FloatArray:
        """Return the voltages with which the stage follows the next displacements.

        The displacements, shape (n,), are those that the sensor is to measure. The voltages are
        those of the samples earlier by the preview. Raises `Infeasible`.
        """
        hysteresis_um = self.before_linear(displacement_um)
        hysteresis = self.model.hysteresis
        check_hysteresis_range(hysteresis_um, hysteresis)
        return hysteresis.invert(hysteresis_um, self.hysteresis)

    def before_linear(self, displacement_um: FloatArray) -> FloatArray:
        """Return the output of the hysteresis with which the stage follows the displacements.

        Parameters and result correspond to those of `continue_with`.
        """
        hysteresis_um, self.creep_state = continue_linear(
            self.creep_inverse, self._before_dynamics(displacement_um), self.creep_state)
        return hysteresis_um

    def _before_dynamics(self, displacement_um: FloatArray) -> FloatArray:
        """Return the output of the creep for which the sensor measures the displacement."""
        wanted_um, self.preview_state = self.preview.apply(
            self._before_effects(displacement_um), self.preview_state)
        return wanted_um

    def _before_effects(self, displacement_um: FloatArray) -> FloatArray:
        """Return the displacement without the effects on it, earlier by the margin."""
        effects = compensated_effects(self.model)
        if not effects:
            return displacement_um
        window_um = np.r_[self.window_um, displacement_um]
        self.window_um = window_um[-2 * EFFECT_MARGIN_SAMPLES:]
        # Mirrored, the window is a period, as the compensation requires.
        period_um = np.r_[window_um, window_um[::-1]]
        for effect in effects:
            try:
                period_um = effect.compensate(period_um, self.sample_period_s)
            except ValueError as error:
                raise Infeasible(str(error)) from None
        return period_um[EFFECT_MARGIN_SAMPLES:window_um.size - EFFECT_MARGIN_SAMPLES]
