# SPDX-License-Identifier: BSD-3-Clause
"""What effects that add a force to one mode of the stage have in common."""

from abc import abstractmethod
from typing import Any

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import Effect, Extent
from piezo_models.effects.stiffening import UNRESOLVED


class SwingingMode(Effect):
    """Solves y = x - G f for the displacement y of a mode G under a further force f.

    x is the displacement without the force. The solution continues from a state, sample by sample.
    """

    frequency_rad_per_s: float
    damping_ratio: float
    viscous: float
    """Further damping by the force, whose part it is: viscous y'/w."""

    @abstractmethod
    def _at_rest(self, level: float) -> FloatArray:
        """Return the state after rest at a level of x."""

    @abstractmethod
    def _swing(self, loads: FloatArray, state: FloatArray, phase: float) -> FloatArray:
        """Return y for x and update the state; in a sample, the mode advances by `phase`."""

    @abstractmethod
    def _force(self, wanted: FloatArray, derivative: ComplexArray) -> ComplexArray:
        """Return the spectrum of the force of a motion y, given the spectrum of d/dt over w."""

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the solution of the equation of motion for the signal as its load."""
        level = float(signal[0]) if rest is None else rest
        return self._continued(signal, sample_period_s, self._at_rest(level))[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the solution; the past is its state."""
        return self._continued(signal, sample_period_s, self._at_rest(float(signal[0]))
                               if past is None else past.copy())

    def _continued(self, signal: FloatArray, sample_period_s: float,
                   state: FloatArray) -> tuple[FloatArray, FloatArray]:
        phase = self.frequency_rad_per_s * sample_period_s
        if phase >= UNRESOLVED:
            return signal.copy(), state
        return self._swing(np.ascontiguousarray(signal, dtype=float), state, phase), state

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Add what the force of the wanted motion removes."""
        rate = 2.0 * np.pi * np.fft.rfftfreq(wanted.size, sample_period_s)
        derivative = np.asarray(1j * rate / self.frequency_rad_per_s, dtype=complex)
        mode = 1.0 / (derivative * derivative + 2.0 * self.damping_ratio * derivative + 1.0)
        removed: FloatArray = np.fft.irfft(mode * self._force(wanted, derivative), wanted.size)
        return wanted + removed

    def impossible(self, extent: Extent) -> str | None:
        """Reject a mode whose small vibrations would grow."""
        if 2.0 * self.damping_ratio + self.viscous < 0.0:
            return "the mode would gain energy in small vibrations"
        return None
