# SPDX-License-Identifier: BSD-3-Clause
"""Rate-independent Preisach hysteresis (thesis eq. (4.2)) with a continuous density.

With span d = alpha - beta and middle m = (alpha + beta) / 2 the density is

    mu(alpha, beta) = (broad + ridge exp(-d / width)) (1 + modulation cos(k (m - centre))),

a product of a function of the span and a function of the middle, and therefore not a sum f(alpha) +
g(beta). The integral over the triangle beta <= beta' <= alpha' <= alpha has the same form: E =
G0(d) + modulation cos(k (m - centre)) G1(d), with G1(d) = 2/k int_0^d g(x) sin(k (d - x)/2) dx for
a density profile g(x) in the span.

The output follows from the stored extremes of the voltage and this integral, without a grid.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import (
    NOT_NEGATIVE,
    POSITIVE,
    Bounded,
    Surroundings,
    parameter,
    require,
)


# Numba's cache ignores changes in other files, so compiled functions that call each other are here.
@njit(cache=True)
def density_um_per_v2(alpha_v: float, beta_v: float, broad: float, ridge: float, width_v: float,
                      modulation: float, centre_v: float, period_v: float) -> float:
    """Return the Preisach density at (alpha, beta), alpha >= beta (mu of thesis eq. (4.2))."""
    span = alpha_v - beta_v
    middle = 0.5 * (alpha_v + beta_v)
    profile = broad + ridge * math.exp(-span / width_v)
    return profile * (1.0 + modulation * math.cos(2.0 * math.pi / period_v * (middle - centre_v)))


@njit(cache=True)
def everett_um(alpha_v: float, beta_v: float, broad: float, ridge: float, width_v: float,
               modulation: float, centre_v: float, period_v: float) -> float:
    """Return the integral of the density over the triangle between beta and alpha in um."""
    span = alpha_v - beta_v
    middle = 0.5 * (alpha_v + beta_v)
    wavenumber = 2.0 * math.pi / period_v
    half = 0.5 * wavenumber
    phase = half * span
    sine = math.sin(phase)
    cosine = math.cos(phase)
    decay_less_one = math.expm1(-span / width_v)
    rate = 1.0 / width_v

    uniform = 0.5 * broad * span * span + ridge * width_v * (span + width_v * decay_less_one)
    broad_wave = broad * (1.0 - cosine) / half
    ridge_wave = (
        ridge
        * (half * (decay_less_one + (1.0 - cosine)) + rate * sine)
        / (half * half + rate * rate)
    )
    wave = (broad_wave + ridge_wave) / half
    return uniform + modulation * math.cos(wavenumber * (middle - centre_v)) * wave


@njit(cache=True)
def _follow(samples: FloatArray, extremes_v: FloatArray, outputs_um: FloatArray, depth: int,
            last_v: float, last_um: float, offset_um: float,
            shape: tuple[float, ...]) -> tuple[int, float, float]:
    """Replace voltages by hysteresis outputs.

    extremes_v[0..depth] are the stored extremes: minimum, maximum, minimum, ...; outputs_um are the
    outputs at those extremes, so that no sum accumulates.
    """
    for n in range(samples.size):
        # Below the saturation voltage all relays are off already.
        voltage = max(samples[n], extremes_v[0])
        if voltage == last_v:
            samples[n] = last_um + offset_um
            continue
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
        extreme = extremes_v[depth]
        if depth % 2 == 0:
            last_um = outputs_um[depth] + everett_um(voltage, extreme, *shape)
        else:
            last_um = outputs_um[depth] - everett_um(extreme, voltage, *shape)
        last_v = voltage
        samples[n] = last_um + offset_um
    return depth, last_v, last_um


@dataclass(frozen=True)
class PreisachHysteresis(Bounded):
    """Preisach hysteresis with the density of this module; relays are 0 or 1."""

    name: ClassVar[str] = "preisach_hysteresis"

    saturation_voltage_v: float = parameter("V")
    broad_density_um_per_v2: float = parameter("um/V^2", NOT_NEGATIVE)
    ridge_density_um_per_v2: float = parameter("um/V^2", NOT_NEGATIVE)
    ridge_width_v: float = parameter("V", POSITIVE)
    position_modulation: float = parameter("1")
    modulation_centre_v: float = parameter("V")
    modulation_period_v: float = parameter("V", POSITIVE)
    offset_um: float = parameter("um")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.broad_density_um_per_v2 + self.ridge_density_um_per_v2 > 0.0
                and abs(self.position_modulation) < 1.0, self,
                "the density must be positive everywhere: give a positive density, and a "
                "position_modulation between -1 and 1.")

    @property
    def shape(self) -> tuple[float, ...]:
        """Return the parameters of the density, in the order of `everett_um`."""
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
    """Hysteresis with the extremes of the voltage as its state."""

    def __init__(self, effect: PreisachHysteresis) -> None:
        self._shape = effect.shape
        self._offset_um = effect.offset_um
        self._extremes_v = np.full(64, effect.saturation_voltage_v)
        self._outputs_um = np.zeros(64)
        self._state = (0, effect.saturation_voltage_v, 0.0)

    def rest(self, level: float) -> float:
        """Go from the present state to the voltage `level`; return the output."""
        samples = np.array([level])
        self.apply(samples)
        return float(samples[0])

    def apply(self, samples: FloatArray) -> None:
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
