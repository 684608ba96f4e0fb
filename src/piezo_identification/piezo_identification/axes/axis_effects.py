# SPDX-License-Identifier: BSD-3-Clause
"""Effects on a stage of several axes that change its linear model."""

import cmath
import math
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.settling import RINGING
from piezo_models.axes.coupled import NEAR, CoupledModel

PARAMETERS = {"gain": "relative_change", "squareness": "angle_rad",
              "cross_coupling": "gain_um_per_v", "delay": "delay_s"}
"""Parameter of each effect that has one."""

SMALL_STEP = 1e-3
"""Step of the derivatives, for a delay in sample periods and for a mode relative to its frequency
and damping. All other parameters are linear."""

DAMPING_RATIOS = (1e-4, RINGING)
"""Damping ratios of a mode: air alone damps more than the least, and beyond the largest one there
is no resonance."""


@dataclass(frozen=True)
class AxisEffect:
    """An effect on one axis, or from one axis to another, with one parameter.

    ``gain``: an axis moves more by a fraction. ``squareness``: the sensor of an axis is turned
    towards another one by an angle, and sees its displacement. ``cross_coupling``: the actuator of
    another axis also drives this one, by a static displacement for each volt. ``delay``: the
    displacement of an axis comes later.
    """

    name: str
    """One of `PARAMETERS`."""
    axis: str
    from_axis: str = ""
    """The other axis; empty if there is none."""

    @property
    def label(self) -> str:
        """Return the name with the axis or the pair, such as ``squareness[y,x]``."""
        return f"{self.name}[{','.join(filter(None, (self.axis, self.from_axis)))}]"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters, with units."""
        return (PARAMETERS[self.name],)

    @property
    def start(self) -> tuple[float, ...]:
        """Return the values from which a fit starts."""
        return (0.0,)

    @property
    def linear(self) -> slice:
        """Return which parameters are zero without the effect, and linear unless it is a delay."""
        return slice(0, 1)

    def steps(self, model: CoupledModel, values: FloatArray) -> FloatArray:
        """Return the steps of the derivatives, (p,)."""
        return np.array([SMALL_STEP * (model.sample_period_s if self.name == "delay" else 1.0)])

    def bounds(self, model: CoupledModel) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest values, (p,): a sensor's delay cannot be negative."""
        latency_s = model.sample_period_s * float(
            model.latency_samples[model.axes.index(self.axis)])
        return np.array([-latency_s if self.name == "delay" else -np.inf]), np.array([np.inf])

    def overlaps(self, model: CoupledModel, values: FloatArray, away: FloatArray) -> bool:
        """Return whether the effect cannot be distinguished from an error of the model.

        Possible errors of the values are given, (p,).
        """
        return False

    def applied(self, model: CoupledModel, values: FloatArray) -> CoupledModel:
        """Return the model with this effect, whose values have the units that their names state."""
        (value,), row = values, model.axes.index(self.axis)
        if self.name == "delay":
            return _delayed(model, row, value / model.sample_period_s)
        mixed, column = np.eye(len(model.axes)), model.axes.index(self.from_axis or self.axis)
        mixed[row, column] += value
        if self.name == "cross_coupling":
            mixed[row, column] /= model.response(0.0)[0, row, row].real
            return replace(model, residues_um_per_v=model.residues_um_per_v @ mixed,
                           direct_um_per_v=model.direct_um_per_v @ mixed)
        return replace(model, residues_um_per_v=mixed @ model.residues_um_per_v,
                       direct_um_per_v=mixed @ model.direct_um_per_v)


@dataclass(frozen=True)
class ModeOfAxis(AxisEffect):
    """A vibration mode that one axis drives alone: ``vibration_mode`` of this axis.

    Its shape is real: each sensor sees it by a static displacement for each volt, with its delay.
    """

    sensors: tuple[str, ...] = ()
    late_s: tuple[float, ...] = ()
    """Delay of each sensor beyond the latency of the model."""
    guess: tuple[float, ...] = ()
    """Values from which a fit starts."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters, with units."""
        return ("frequency_rad_per_s", "damping_ratio",
                *(f"{axis}_gain_um_per_v" for axis in self.sensors))

    @property
    def start(self) -> tuple[float, ...]:
        """Return the values from which a fit starts."""
        return self.guess

    @property
    def linear(self) -> slice:
        """Return which parameters are zero without the effect: the gains."""
        return slice(2, None)

    def steps(self, model: CoupledModel, values: FloatArray) -> FloatArray:
        """Return the steps of the derivatives, (p,); those of the pole far below its width."""
        frequency, damping = values[:2]
        return SMALL_STEP * np.array([damping * frequency, damping, *np.ones(len(self.sensors))])

    def bounds(self, model: CoupledModel) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest values, (p,): of a resonance that the samples show."""
        nyquist, free = np.pi / model.sample_period_s, np.full(len(self.sensors), np.inf)
        low, high = DAMPING_RATIOS
        return (np.array([SMALL_STEP * nyquist, low, *-free]), np.array([nyquist, high, *free]))

    def overlaps(self, model: CoupledModel, values: FloatArray, away: FloatArray) -> bool:
        """Return whether the resonance overlaps with a mode of the model that may have moved."""
        known = model.poles_rad_per_s[model.poles_rad_per_s.imag > 0.0]
        apart, moved = np.abs(np.abs(known) - values[0]), NEAR * np.abs(known)
        return bool(np.any(apart < away[0] + moved + values[0] * values[1] - known.real))

    def deviations(self, model: CoupledModel, values: FloatArray,
                   off: FloatArray) -> tuple[complex, ComplexArray]:
        """Return the standard deviations of the pole and of the residues, (1, n, n).

        Those of the values are given, (p,).
        """
        residue = self._mode(model, values)[1]
        pole_off = complex(np.hypot(off[0] * values[1], values[0] * off[1]), off[0])
        found = np.zeros((1, *model.residues_um_per_v.shape[1:]), dtype=complex)
        found[0, :, model.axes.index(self.axis)] = off[2:] * (
            np.abs(residue.real) + 1j * np.abs(residue.imag))
        return pole_off, found

    def applied(self, model: CoupledModel, values: FloatArray) -> CoupledModel:
        """Return the model with this mode as its first one."""
        pole, residue = self._mode(model, values)
        added = np.zeros((1, *model.residues_um_per_v.shape[1:]), dtype=complex)
        added[0, :, model.axes.index(self.axis)] = residue * values[2:]
        softening = model.softening and replace(
            model.softening, elongations=np.insert(model.softening.elongations, 0, 0.0, axis=1))
        return replace(model, poles_rad_per_s=np.concatenate([[pole], model.poles_rad_per_s]),
                       residues_um_per_v=np.concatenate([added, model.residues_um_per_v]),
                       softening=softening)

    def _mode(self, model: CoupledModel, values: FloatArray) -> tuple[complex, ComplexArray]:
        """Return the pole, and the residue in each sensor for a static gain of 1, (n,)."""
        pole, residue = held_mode(float(values[0]), float(values[1]), model.sample_period_s)
        return pole, residue * np.exp(-pole * np.array(self.late_s))


def held_mode(frequency_rad_per_s: float, damping_ratio: float,
              sample_period_s: float) -> tuple[complex, complex]:
    """Return the pole and the sampled residue of a mode with a static gain of 1.

    The voltage is held between the samples.
    """
    pole = frequency_rad_per_s * complex(-damping_ratio, math.sqrt(1.0 - damping_ratio**2))
    held = (cmath.exp(pole * sample_period_s) - 1.0) / pole
    return pole, held * frequency_rad_per_s**2 / (2j * pole.imag)


def all_effects(axes: tuple[str, ...]) -> list[AxisEffect]:
    """Return every effect with one parameter on every axis, or between every pair of them."""
    alone = [AxisEffect(name, axis) for name in ("gain", "delay") for axis in axes]
    return alone + [AxisEffect(name, *pair) for name in ("squareness", "cross_coupling")
                    for pair in permutations(axes, 2)]


def _delayed(model: CoupledModel, row: int, samples: float) -> CoupledModel:
    """Return a model in which the displacement of one axis comes later.

    Between samples a mode moves on by its pole, and for a part of a sample under the last voltage,
    as in `CoupledModel.at_period`. The direct part is interpolated.
    """
    whole = math.floor(samples)
    part, latency = samples - whole, model.latency_samples.copy()
    latency[row] += whole
    steps = np.exp(model.poles_rad_per_s * model.sample_period_s)
    residues, seen = model.residues_um_per_v.copy(), model.residues_um_per_v[:, row]
    residues[:, row] = seen * (steps**-part)[:, None]
    within = model.multiples * ((1.0 - steps ** (1.0 - part)) / (1.0 - steps) - steps**-part)
    direct = np.pad(model.direct_um_per_v, ((0, 1), (0, 0), (0, 0)))
    direct[:, row] = (1.0 - part) * direct[:, row] + part * np.roll(direct[:, row], 1, axis=0)
    direct[1, row] += (within @ seen).real
    return replace(model, residues_um_per_v=residues, direct_um_per_v=direct,
                   latency_samples=latency)
