# SPDX-License-Identifier: BSD-3-Clause
"""Rate-independent Preisach hysteresis (thesis eq. (4.2)) on a memory of extremes."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_sim.density import everett_um
from piezo_sim.effect import Surroundings, parameter, require


@njit(cache=True)
def _follow(samples, extremes_v, outputs_um, depth, last_v, last_um, offset_um, shape):
    """Replace voltages by hysteresis outputs.

    extremes_v[0..depth] are the remembered extremes: minimum, maximum, minimum, ...; outputs_um
    are the outputs at those extremes, so that nothing is ever summed up twice.
    """
    for n in range(samples.size):
        # Below the saturation voltage every relay is off already.
        voltage = max(samples[n], extremes_v[0])
        rising = depth % 2 == 0
        turned = voltage < last_v if rising else voltage > last_v
        if turned:
            depth += 1
            extremes_v[depth] = last_v
            outputs_um[depth] = last_um
            rising = not rising
        while depth >= 2 and (
            voltage >= extremes_v[depth - 1] if rising else voltage <= extremes_v[depth - 1]
        ):
            depth -= 2
        if depth == 1 and voltage <= extremes_v[0]:
            depth = 0
        extreme = extremes_v[depth]
        if depth % 2 == 0:
            last_um = outputs_um[depth] + everett_um(voltage, extreme, *shape)
        else:
            last_um = outputs_um[depth] - everett_um(extreme, voltage, *shape)
        last_v = voltage
        samples[n] = last_um + offset_um
    return depth, last_v, last_um


@dataclass(frozen=True)
class PreisachHysteresis:
    """Preisach hysteresis with the continuous density of `piezo_sim.density`; relays are 0 or 1."""

    name: ClassVar[str] = "preisach_hysteresis"

    saturation_voltage_v: float = parameter("V")
    broad_density_um_per_v2: float = parameter("um/V^2")
    ridge_density_um_per_v2: float = parameter("um/V^2")
    ridge_width_v: float = parameter("V")
    position_modulation: float = parameter("1")
    modulation_centre_v: float = parameter("V")
    modulation_period_v: float = parameter("V")
    offset_um: float = parameter("um")

    def __post_init__(self):
        require(
            self.broad_density_um_per_v2 >= 0.0
            and self.ridge_density_um_per_v2 >= 0.0
            and self.broad_density_um_per_v2 + self.ridge_density_um_per_v2 > 0.0
            and abs(self.position_modulation) < 1.0,
            self,
            "the density must be positive everywhere: give densities that are not negative, one of "
            "them positive, and a position_modulation between -1 and 1.",
        )
        require(
            self.ridge_width_v > 0.0 and self.modulation_period_v > 0.0,
            self,
            "ridge_width_v and modulation_period_v must be positive.",
        )

    @property
    def shape(self) -> tuple[float, ...]:
        """Parameters of the density, in the order of `piezo_sim.density`."""
        return (
            self.broad_density_um_per_v2,
            self.ridge_density_um_per_v2,
            self.ridge_width_v,
            self.position_modulation,
            self.modulation_centre_v,
            self.modulation_period_v,
        )

    def start(self, surroundings: Surroundings) -> "HysteresisRunner":
        """Start with all relays off."""
        return HysteresisRunner(self)


class HysteresisRunner:
    """Hysteresis with its memory of extremes."""

    def __init__(self, effect: PreisachHysteresis):
        self._shape = effect.shape
        self._offset_um = effect.offset_um
        self._extremes_v = np.full(64, effect.saturation_voltage_v)
        self._outputs_um = np.zeros(64)
        self._state = (0, effect.saturation_voltage_v, 0.0)

    def rest(self, level: float) -> float:
        """Go from the present memory to the voltage `level`; return the output."""
        samples = np.array([level])
        self.apply(samples)
        return float(samples[0])

    def apply(self, samples: np.ndarray) -> None:
        """Replace voltages by hysteresis outputs in um."""
        # Each sample adds at most one extreme.
        needed = self._state[0] + samples.size + 1
        if needed > self._extremes_v.size:
            self._grow(needed)
        self._state = _follow(
            samples, self._extremes_v, self._outputs_um, *self._state, self._offset_um, self._shape
        )

    def _grow(self, needed: int) -> None:
        capacity = 2 ** math.ceil(math.log2(needed))
        depth = self._state[0]
        for name in ("_extremes_v", "_outputs_um"):
            grown = np.empty(capacity)
            grown[: depth + 1] = getattr(self, name)[: depth + 1]
            setattr(self, name, grown)
