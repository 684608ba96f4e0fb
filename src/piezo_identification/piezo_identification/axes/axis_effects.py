# SPDX-License-Identifier: BSD-3-Clause
"""Effects on a stage of several axes that change its linear model, with one parameter each."""

import math
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from piezo_models.axes.coupled import CoupledModel

PARAMETERS = {"gain": "relative_change", "squareness": "angle_rad",
              "cross_coupling": "gain_um_per_v", "delay": "delay_s"}
"""Parameter of each effect."""


@dataclass(frozen=True)
class AxisEffect:
    """An effect on one axis, or from one axis to another.

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

    def least(self, model: CoupledModel) -> float:
        """Return the lowest parameter: a sensor's delay cannot be negative."""
        if self.name != "delay":
            return -math.inf
        return -float(model.latency_samples[model.axes.index(self.axis)]) * model.sample_period_s

    def applied(self, model: CoupledModel, value: float) -> CoupledModel:
        """Return the model with this effect.

        Parameters
        ----------
        value : float
            The parameter, in the unit that its name states.
        """
        row = model.axes.index(self.axis)
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


def all_effects(axes: tuple[str, ...]) -> list[AxisEffect]:
    """Return every effect on every axis, or from every axis to every other one."""
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
