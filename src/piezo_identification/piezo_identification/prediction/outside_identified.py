# SPDX-License-Identifier: BSD-3-Clause
"""Find samples outside the range in which a model was identified, and their uncertainty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation, label

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.estimators.hysteresis.everett_regression import summed_over_corners
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel

NEAR_VISITED = 0.03
"""Distance from visited cells within which a smooth density is known, as a fraction of the voltage
range."""

BEYOND = 1e-6
"""Excess over the voltage range that is attributed to rounding, as a fraction of the range."""


@dataclass(frozen=True, eq=False)
class OutsideIdentified:
    """Samples at which a model has not been identified."""

    beyond: BoolArray
    """True where the voltage is outside the range of the model, whose hysteresis is constant there,
    (N,)."""
    unvisited: BoolArray
    """True where the output depends on cells of the Preisach plane that no recording determined,
    (N,)."""
    deviation_um: FloatArray
    """Standard deviation of the displacement from these two causes, (N,); 0 without a cause."""
    voltage_range_v: tuple[float, float]
    """Voltage range of the model."""

    @property
    def outside(self) -> BoolArray:
        """Mask of the samples that are beyond or unvisited, shape (N,)."""
        return self.beyond | self.unvisited

    def sentences(self) -> list[str]:
        """Return sentences on the fraction of samples outside, and their uncertainty."""
        low_v, high_v = self.voltage_range_v
        remarks = []
        for mask, where in (
                (self.beyond, f"beyond the model's voltages, {low_v:g} to {high_v:g} V, at which "
                              "its hysteresis stands still"),
                (self.unvisited, "in a part of the Preisach plane that no recording of the model "
                                 "visited, where its density is a continuation")):
            if mask.any():
                deviation_um = np.sqrt(np.mean(self.deviation_um[mask] ** 2))
                remarks.append(
                    f"{100.0 * mask.mean():.3g} % of the samples lie {where}: standard deviation "
                    f"of the displacement there {deviation_um:.3g} um; identify the model on loops "
                    "that go there")
        return remarks


def outside_identified(
    identified: IdentifiedModel, voltage_v: ArrayLike, past_v: tuple[float, ...] = (),
) -> OutsideIdentified:
    """Find where a voltage is outside the range in which a model was identified.

    The output is a sum of Everett values, one for each extreme in memory. The value at a visited
    corner is known. At another corner, the mass m of the unvisited cells that it includes may be
    anything between none and all of the mass M of their connected block. Its variance is assumed to
    be m (M - m) / 3, that of a Dirichlet distribution with concentration 2. Outside the voltage
    range of the model, the standard deviation is the excess voltage times the largest gain.

    For a model without `visited`, only voltages outside its range are found. The voltage, (N,),
    begins with the first sample that influences the hysteresis; `past_v` are earlier ones.
    """
    hysteresis = identified.model.hysteresis
    voltage_v = np.asarray(voltage_v, dtype=float)
    low_v, high_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
    excess_v = np.maximum(np.maximum(voltage_v - high_v, low_v - voltage_v), 0.0)
    beyond = excess_v > BEYOND * (high_v - low_v)
    deviation_um = excess_v * hysteresis.gain_um_per_v()[1] * beyond
    unvisited = np.zeros(voltage_v.size, dtype=bool)
    if identified.visited is not None:
        variance = everett_variance_um2(hysteresis, identified.visited)
        of_samples = summed_over_corners(
            variance, np.concatenate([past_v, voltage_v]), hysteresis.levels_v)[len(past_v):]
        unvisited = of_samples > 0.0
        deviation_um = np.sqrt(deviation_um**2 + of_samples)
    return OutsideIdentified(beyond, unvisited, deviation_um, (low_v, high_v))


def everett_variance_um2(hysteresis: PreisachModel, visited: BoolArray) -> FloatArray:
    """Return the variance of the Everett value in each cell from the unvisited cells it includes.

    Both arrays are (L, L). The variance is 0 in visited cells, which the recordings determine, and
    near them.
    """
    size = len(visited)
    near = binary_dilation(visited, iterations=max(1, round(NEAR_VISITED * size)))
    unknown = np.tril(~near)
    blocks, count = label(unknown)
    area = np.tril(np.ones((size, size))) - 0.5 * np.eye(size)
    mass_um = hysteresis.density_um_per_v2 * area * hysteresis.cell_width_v**2
    variance = np.zeros((size, size))
    for block in range(1, count + 1):
        of_block = np.where(blocks == block, mass_um, 0.0)
        # A corner includes cells with lower upper thresholds and higher lower thresholds.
        included = np.cumsum(np.cumsum(of_block, axis=0)[:, ::-1], axis=1)[:, ::-1]
        whole = float(of_block.sum())
        variance += np.maximum(included * (whole - included), 0.0) / 3.0
    return np.where(unknown, variance, 0.0)
