# SPDX-License-Identifier: BSD-3-Clause
"""The inverse of a whole model, that goes on from chunk to chunk with a bounded memory."""

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

# What the compensation of an effect looks at before and after the samples it compensates.
EFFECT_MARGIN_SAMPLES = 80


def compensated_effects(model: StageModel) -> tuple[Effect, ...]:
    """Return the effects that a stream compensates, the last first."""
    return tuple(effect for place in ("sensor", "displacement")
                 for effect in reversed(model.effects_at(place)) if effect.follows_voltage)


@dataclass
class OnlineInverse:
    """The inverse of a model with its memory: displacements in, voltages out.

    The dynamics by a filter with preview, the slow creep by its causal inverse, the hysteresis by
    its exact inverse; the states of all three go on from chunk to chunk.
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
        """Return the same inverse with a memory of its own."""
        return replace(self, hysteresis=self.hysteresis.copy())

    def look_ahead(self, displacement_um: FloatArray) -> None:
        """Take the first displacements, before any voltage is known."""
        self._before_dynamics(displacement_um)

    def continue_with(self, displacement_um: FloatArray) -> FloatArray:
        """Compute the voltages for which the stage will have followed the next displacements.

        Parameters
        ----------
        displacement_um : ndarray, shape (n,)
            What the sensor is to measure: the next of the preview.

        Returns
        -------
        voltage_v : ndarray, shape (n,)
            Of the samples a preview earlier.

        Raises
        ------
        Infeasible
        """
        hysteresis_um = self.before_linear(displacement_um)
        hysteresis = self.model.hysteresis
        check_hysteresis_range(hysteresis_um, hysteresis)
        return hysteresis.invert(hysteresis_um, self.hysteresis)

    def before_linear(self, displacement_um: FloatArray) -> FloatArray:
        """Return the output of the hysteresis for which the stage would have followed.

        Parameters and result are as those of `continue_with`.
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
        """Return the displacement in front of the effects on it, a margin earlier."""
        effects = compensated_effects(self.model)
        if not effects:
            return displacement_um
        window_um = np.r_[self.window_um, displacement_um]
        self.window_um = window_um[-2 * EFFECT_MARGIN_SAMPLES:]
        # Mirrored it is a period, which is what effects compensate.
        period_um = np.r_[window_um, window_um[::-1]]
        for effect in effects:
            try:
                period_um = effect.compensate(period_um, self.sample_period_s)
            except ValueError as error:
                raise Infeasible(str(error)) from None
        return period_um[EFFECT_MARGIN_SAMPLES:window_um.size - EFFECT_MARGIN_SAMPLES]
