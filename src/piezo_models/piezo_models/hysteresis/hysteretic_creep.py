# SPDX-License-Identifier: BSD-3-Clause
"""Creep that depends on the branch of the hysteresis: play operators whose outputs relax."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray


@dataclass(eq=False)
class HystereticCreepMemory:
    """Positions of the play operators, and the relaxing states that follow them, in V."""

    positions_v: FloatArray
    states_v: FloatArray

    def copy(self) -> "HystereticCreepMemory":
        """Return an independent memory with the same past."""
        return HystereticCreepMemory(self.positions_v.copy(), self.states_v.copy())


@dataclass(frozen=True)
class HystereticCreep:
    """Sum of w x with tau dx/dt = play(voltage) - x, parallel to the hysteresis (thesis 6.2)."""

    half_widths_v: tuple[float, ...]
    time_constants_s: tuple[float, ...]
    weights_um_per_v: tuple[float, ...]
    """One of each for an operator: half the width of its play, its time constant tau and its weight
    w. The time constants must be long compared with a sample period."""

    def __post_init__(self) -> None:
        for name in ("half_widths_v", "time_constants_s", "weights_um_per_v"):
            values = tuple(float(value) for value in getattr(self, name))
            if not np.isfinite(values).all():
                raise ValueError(f"{name} is {values}; give finite numbers")
            object.__setattr__(self, name, values)
        if min(self.half_widths_v, default=0.0) < 0.0:
            raise ValueError(f"half_widths_v is {self.half_widths_v}; give none below 0")
        if min(self.time_constants_s, default=1.0) <= 0.0:
            raise ValueError(f"time_constants_s is {self.time_constants_s}; give positive times")
        counts = {len(self.half_widths_v), len(self.time_constants_s), len(self.weights_um_per_v)}
        if len(counts) > 1:
            raise ValueError(
                f"there are {len(self.half_widths_v)} half widths, {len(self.time_constants_s)} "
                f"time constants and {len(self.weights_um_per_v)} weights; give one of each for "
                "an operator"
            )

    def memory(self, extremes_v: ArrayLike, settled: bool = True) -> HystereticCreepMemory:
        """Return the memory after a sequence of voltages that begins at negative saturation.

        Parameters
        ----------
        extremes_v : (M,) array_like
            All extremes that are not wiped out, as a `PreisachMemory` has them.
        settled : bool
            True: the stage has rested at the last voltage until the creep was over. False: the
            relaxing states are zero.
        """
        extremes = np.asarray(extremes_v, dtype=float)
        half_widths = np.array(self.half_widths_v)
        positions = extremes[0] + half_widths
        for voltage in extremes[1:]:
            positions = np.clip(positions, voltage - half_widths, voltage + half_widths)
        return HystereticCreepMemory(
            positions, positions.copy() if settled else np.zeros_like(positions)
        )

    def held_um(self, memory: HystereticCreepMemory) -> float:
        """Return the output with the states of a memory."""
        return float(np.dot(self.weights_um_per_v, memory.states_v))

    def simulate(self, voltage_v: ArrayLike, sample_period_s: float,
                 memory: HystereticCreepMemory) -> FloatArray:
        """Return the output at the sample instants, (N,), in um.

        Parameters
        ----------
        voltage_v : (N,) array_like
            Voltages, each held for a sample period.
        memory : HystereticCreepMemory
            Past of the operators; continued, and updated in place.
        """
        decays = np.exp(-sample_period_s / np.array(self.time_constants_s))
        return _simulate(
            np.ascontiguousarray(voltage_v, dtype=float), np.array(self.half_widths_v), decays,
            np.array(self.weights_um_per_v), memory.positions_v, memory.states_v,
        )


@njit(cache=True, nogil=True)
def _simulate(voltage: FloatArray, half_widths: FloatArray, decays: FloatArray,
              weights: FloatArray, positions: FloatArray, states: FloatArray) -> FloatArray:
    output = np.zeros(voltage.size)
    for n in range(voltage.size):
        for i in range(half_widths.size):
            output[n] += weights[i] * states[i]
            low, high = voltage[n] - half_widths[i], voltage[n] + half_widths[i]
            positions[i] = min(max(positions[i], low), high)
            states[i] = positions[i] + decays[i] * (states[i] - positions[i])
    return output
