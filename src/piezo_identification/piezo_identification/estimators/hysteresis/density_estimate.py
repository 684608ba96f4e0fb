# SPDX-License-Identifier: BSD-3-Clause
"""Result of every method of estimating the Preisach density."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.hysteresis.play_fit import PlaySum
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.model_summary import visited_fraction

LINE = "a line, which predicts what is held out as well as a hysteresis"
"""Method of an estimate whose density is zero: the displacement is proportional to the voltage."""

LINE_OF_RESPONSE = "a line, as a frequency response shows no hysteresis"


@dataclass(frozen=True, eq=False)
class DensityEstimate:
    """An estimated density, and how far the data determine it."""

    method: str

    levels_v: FloatArray
    """Edges of the cells, (n + 1,)."""
    density_um_per_v2: FloatArray
    """Lower triangular, (n, n)."""
    offset_um: float
    """Output at negative saturation."""
    visited: NDArray[np.bool_]
    """Cells in which the moving corner of the memory has been, (n, n). The data do not determine
    the density elsewhere, where it is continued by smoothing or by the least norm."""
    reversible_um_per_v: FloatArray
    """Reversible part on the diagonal, alpha = beta, (n,)."""
    smoothing_weight: float | None = None
    """Weight of the curvature in the smoothed method."""
    translation_weight: float = 0.0
    """Weight of the change along the diagonal in the smoothed method."""
    plays: PlaySum | None = None
    """Sum of plays about which the density is smoothed."""

    @property
    def is_line(self) -> bool:
        """True if there is no hysteresis."""
        return not self.density_um_per_v2.any()

    @property
    def visited_fraction(self) -> float:
        """Fraction of the area of the Preisach plane that was visited."""
        return visited_fraction(self.visited)

    def model(self) -> PreisachModel:
        """Return the hysteresis as a `PreisachModel`."""
        return PreisachModel(
            self.levels_v[0], self.levels_v[-1], self.density_um_per_v2, self.offset_um,
            self.reversible_um_per_v,
        )

    def report(self) -> str:
        """Return a line for the user: method, grid, and the visited fraction."""
        if self.is_line:
            return f"{self.method}: {self.reversible_um_per_v[0]:.6g} um/V"
        method = f"{self.method}, about a sum of plays" if self.plays is not None else self.method
        words = [f"{method}, {len(self.visited)} x {len(self.visited)} cells"]
        if self.smoothing_weight is not None:
            words.append(f"smoothing weight {self.smoothing_weight:.0e}")
        if self.translation_weight:
            words.append(f"translation weight {self.translation_weight:.0e}")
        visited = f"{100.0 * self.visited_fraction:.1f} % of the Preisach plane visited"
        if self.visited_fraction < 1.0:
            visited += ", in the rest the density is a continuation"
        return "; ".join([*words, visited])


def lower_triangle(values: FloatArray, size: int) -> FloatArray:
    """Square matrix from values counted i-major with j <= i; zero above the diagonal."""
    square = np.zeros((size, size))
    square[np.tril_indices(size)] = values
    return square


def per_volt(bounded_um: FloatArray, size: int,
             levels_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the density (um/V^2) and the reversible part (um/V) of the cells of a grid."""
    density_um, reversible_um = np.split(bounded_um, [-size])
    width_v = (levels_v[-1] - levels_v[0]) / size
    return lower_triangle(density_um, size) / width_v**2, reversible_um / width_v
