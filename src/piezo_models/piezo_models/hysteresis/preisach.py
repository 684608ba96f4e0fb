# SPDX-License-Identifier: BSD-3-Clause
"""Preisach hysteresis with a piecewise-constant density, exact through its Everett function.

The relays are 0/1, as in the thesis, eq. (2.1) and (4.2). The output is a sum of Everett integrals
over the stored voltage extremes, so a sample costs a table look-up for any number of relays.
Wiping-out keeps the memory short. Every extreme is stored with its output, so no sum accumulates
over time and nothing drifts.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_models.hysteresis.preisach_inversion import invert
from piezo_models.hysteresis.preisach_kernels import (
    Grid,
    Table,
    everett_table,
    everett_values,
    simulate,
)

RANGE_TOLERANCE = 1e-9
"""A target that exceeds the output range by less is limited to it as a rounding error."""
ROUNDING = 16 * float(np.finfo(float).eps)
"""Accuracy of a sum of Everett integrals, a few roundings of a double. No flat stretch is
crossed for a smaller remainder."""


@dataclass(eq=False)
class PreisachMemory:
    """Memory of the hysteresis: the alternating voltage extremes that are not wiped out.

    Entry 0 is negative saturation, odd entries are maxima, even entries are minima, and the entry
    at `top` is the present point. Everything above `top` is free space.
    """

    model: "PreisachModel"
    extremes_v: FloatArray
    outputs_um: FloatArray
    top: int

    @property
    def voltage_v(self) -> float:
        """Present voltage in V, within the range of the model."""
        return float(self.extremes_v[self.top])

    @property
    def hysteresis_um(self) -> float:
        """Present hysteresis output in um."""
        return float(self.outputs_um[self.top])

    def copy(self) -> "PreisachMemory":
        """Return an independent memory with the same past."""
        return replace(self, extremes_v=self.extremes_v.copy(), outputs_um=self.outputs_um.copy())


@dataclass(frozen=True, eq=False)
class PreisachModel:
    """Preisach hysteresis, eq. (2.1), whose density is constant on each cell of a uniform grid.

    Raises
    ------
    ValueError
        If the limits are not increasing, or the density is not square, not finite, or not zero
        above the diagonal, or the reversible part is not finite or of another length.
    """

    voltage_min_v: float
    voltage_max_v: float
    """Limits of the Preisach triangle. A voltage beyond them acts like the limit: all relays are
    off below `voltage_min_v` and on above `voltage_max_v`."""
    density_um_per_v2: FloatArray
    """Row i is the cell of the upper threshold alpha, column j <= i that of the lower threshold
    beta, (L, L); zero above the diagonal. The cells on the diagonal are triangles."""
    offset_um: float = 0.0
    """Output at negative saturation, where all relays are off."""
    reversible_um_per_v: FloatArray = None  # type: ignore[assignment]  # becomes zeros
    """Density of the relays with equal thresholds, alpha = beta, on each cell of the diagonal,
    (L,): the slope of the output that remains at a reversal. Zeros by default."""

    def __post_init__(self) -> None:
        density = np.array(self.density_um_per_v2, dtype=float)
        if density.ndim != 2 or density.shape[0] != density.shape[1] or density.size == 0:
            raise ValueError(f"density_um_per_v2 has shape {density.shape}; give a square matrix")
        if not np.isfinite(density).all():
            raise ValueError("density_um_per_v2 holds a value that is not finite; remove it")
        if np.triu(density, 1).any():
            raise ValueError(
                "density_um_per_v2 is not zero above the diagonal, where beta would exceed alpha; "
                "give a lower-triangular matrix"
            )
        voltage_min, voltage_max = float(self.voltage_min_v), float(self.voltage_max_v)
        if not (np.isfinite([voltage_min, voltage_max]).all() and voltage_min < voltage_max):
            raise ValueError(
                f"the voltage range {voltage_min} to {voltage_max} V is empty or not finite; "
                "give voltage_min_v below voltage_max_v"
            )
        if not np.isfinite(self.offset_um):
            raise ValueError("offset_um is not finite; give the output at negative saturation")
        reversible = np.zeros(len(density))
        if self.reversible_um_per_v is not None:
            reversible = np.array(self.reversible_um_per_v, dtype=float)
        if reversible.shape != (len(density),) or not np.isfinite(reversible).all():
            raise ValueError(
                f"reversible_um_per_v has shape {reversible.shape} or is not finite; give a number "
                f"for each of the {len(density)} cells of the diagonal"
            )
        density.flags.writeable = reversible.flags.writeable = False
        object.__setattr__(self, "voltage_min_v", voltage_min)
        object.__setattr__(self, "voltage_max_v", voltage_max)
        object.__setattr__(self, "density_um_per_v2", density)
        object.__setattr__(self, "offset_um", float(self.offset_um))
        object.__setattr__(self, "reversible_um_per_v", reversible)

    @classmethod
    def line(cls, voltage_min_v: float, voltage_max_v: float, gain_um_per_v: float,
             offset_um: float = 0.0, cells: int = 1) -> Self:
        """Return a gain without hysteresis; the offset is its output at the lowest voltage.

        A fit changes the slopes of several cells independently, so that a curve results.
        """
        return cls(voltage_min_v, voltage_max_v, np.zeros((cells, cells)), offset_um,
                   np.full(cells, gain_um_per_v))

    def scaled(self, factor: float) -> Self:
        """Return the hysteresis with its output multiplied by a factor."""
        return replace(self, density_um_per_v2=factor * self.density_um_per_v2,
                       offset_um=factor * self.offset_um,
                       reversible_um_per_v=factor * self.reversible_um_per_v)

    def __repr__(self) -> str:
        return (f"<PreisachModel: {self.voltage_min_v:g} to {self.voltage_max_v:g} V, "
                f"{self.travel_um:.4g} um, {len(self.density_um_per_v2)} cells a side>")

    @property
    def cell_width_v(self) -> float:
        """Return the width of a cell of the grid in V."""
        return (self.voltage_max_v - self.voltage_min_v) / self.density_um_per_v2.shape[0]

    @property
    def levels_v(self) -> FloatArray:
        """Return the edges of the cells in V, shape (L + 1,)."""
        size = self.density_um_per_v2.shape[0]
        return np.linspace(self.voltage_min_v, self.voltage_max_v, size + 1)

    @cached_property
    def output_range_um(self) -> tuple[float, float]:
        """Return the output in um at negative and at positive saturation."""
        span = self.everett_um(self.voltage_max_v, self.voltage_min_v)
        return self.offset_um, self.offset_um + float(span)

    @property
    def travel_um(self) -> float:
        """Return the output at positive saturation minus that at negative saturation in um."""
        low_um, high_um = self.output_range_um
        return high_um - low_um

    @property
    def mean_gain_um_per_v(self) -> float:
        """Return the mean slope over the voltage range in um/V."""
        return self.travel_um / (self.voltage_max_v - self.voltage_min_v)

    @cached_property
    def _has_negative_cells(self) -> bool:
        return bool(np.any(self.density_um_per_v2 < 0) or np.any(self.reversible_um_per_v < 0))

    @cached_property
    def is_line(self) -> bool:
        """True if the output does not depend on the past."""
        return not self.density_um_per_v2.any()

    @cached_property
    def _table(self) -> Table:
        return everett_table(
            self.density_um_per_v2, self.reversible_um_per_v, self.cell_width_v
        )

    @property
    def _grid(self) -> tuple[float, float, float]:
        return self.voltage_min_v, self.voltage_max_v, self.cell_width_v

    def kernel_arguments(self) -> tuple[Grid, Table, float]:
        """Return grid, table and rounding (um) for calls of the kernels."""
        largest_um = abs(self.offset_um) + self.travel_um
        return self._grid, self._table, ROUNDING * largest_um

    def everett_um(self, alpha_v: ArrayLike, beta_v: ArrayLike) -> FloatArray:
        """Integrate the density over beta_v <= beta <= alpha <= alpha_v: the Everett function.

        It is the rise of the output (um) from a minimum beta_v to alpha_v, and the fall from a
        maximum alpha_v to beta_v; zero if alpha_v <= beta_v. The voltages are broadcast against
        each other, and limited to the voltage range. Raises ValueError if one is not finite.
        """
        limits = self.voltage_min_v, self.voltage_max_v
        alpha, beta = np.broadcast_arrays(np.clip(alpha_v, *limits), np.clip(beta_v, *limits))
        if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
            raise ValueError("alpha_v and beta_v must be finite voltages")
        values = everett_values(alpha.flatten(), beta.flatten(), self._grid, self._table)
        return values.reshape(alpha.shape)[()]

    def memory(self) -> PreisachMemory:
        """Return the memory of negative saturation: all relays off at `voltage_min_v`."""
        extremes, outputs = np.empty(16), np.empty(16)
        extremes[0], outputs[0] = self.voltage_min_v, self.offset_um
        return PreisachMemory(self, extremes, outputs, 0)

    def _own(self, memory: PreisachMemory | None) -> PreisachMemory:
        if memory is None:
            return self.memory()
        if memory.model is not self:
            raise ValueError(
                "the memory belongs to another model; take one from this model's memory()"
            )
        return memory

    def simulate(self, voltage_v: ArrayLike,
                 memory: PreisachMemory | None = None) -> FloatArray:
        """Return the hysteresis output in um, (N,), for a sequence of voltages.

        Parameters
        ----------
        voltage_v : (N,) array_like
            Voltages beyond the range act as its limits.
        memory : PreisachMemory, optional
            Past of this same model; continued, and updated in place. Wiped by default.

        Raises
        ------
        ValueError
            If a voltage is not finite, or the memory is that of another model.
        """
        voltage = _finite_sequence(voltage_v, "voltage_v")
        memory = self._own(memory)
        output, memory.extremes_v, memory.outputs_um, memory.top = simulate(
            voltage, memory.extremes_v, memory.outputs_um, memory.top, self._grid, self._table
        )
        return output

    def line_beyond_um(self, voltage_v: FloatArray) -> FloatArray:
        """Return the output that a line without hysteresis adds beyond its range in um, else 0.

        Simulations add it, as a line that was identified on a small range can be extrapolated.
        `simulate` and `invert` do not, as a stage is not driven beyond the identified voltages.
        """
        if not self.is_line:
            return np.broadcast_to(0.0, voltage_v.shape)
        low_um_per_v, high_um_per_v = self.reversible_um_per_v[[0, -1]]
        return np.asarray(low_um_per_v * np.minimum(voltage_v - self.voltage_min_v, 0.0)
                          + high_um_per_v * np.maximum(voltage_v - self.voltage_max_v, 0.0))

    def line_um(self, voltage_v: FloatArray) -> FloatArray:
        """Return the output of a line or curve in um, (N,), continued beyond its range.

        It equals that of `simulate` and `line_beyond_um`, without a memory.
        """
        slopes_um_per_v = self.reversible_um_per_v
        if np.ptp(slopes_um_per_v) == 0.0:
            return self.offset_um + slopes_um_per_v[0] * (voltage_v - self.voltage_min_v)
        at_levels_um = self.offset_um + self.cell_width_v * np.cumsum([0.0, *slopes_um_per_v])
        within_um = np.interp(voltage_v, self.levels_v, at_levels_um)
        return np.asarray(within_um + self.line_beyond_um(voltage_v))

    def invert(self, hysteresis_um: ArrayLike,
               memory: PreisachMemory | None = None) -> FloatArray:
        """Return the voltages in V, (N,), whose hysteresis output is given: the exact inverse.

        The output determines the voltage only where its slope is not zero. Where the density makes
        it flat, the voltage moves as little as possible: it is constant while the target is
        constant, goes to the first voltage that reaches a new target, and returns to the nearest
        stored extreme whose output is the target, so that a periodic target gives a periodic
        voltage. Just after a reversal the slope starts from zero, and a rounding error e of the
        target moves the voltage by at most sqrt(2 e / density).

        Parameters
        ----------
        hysteresis_um : (N,) array_like
        memory : PreisachMemory, optional
            Past of this same model; continued, and updated in place. Wiped by default.

        Raises
        ------
        ValueError
            If a target is not finite or out of range, a density is negative, so that several
            voltages give one output, or the memory is that of another model. The memory is then
            unchanged.
        """
        target = _finite_sequence(hysteresis_um, "hysteresis_um")
        if self._has_negative_cells:
            raise ValueError(
                "the density has negative cells, so the hysteresis has no inverse; "
                "fit it by non-negative least squares"
            )
        low, high = self.output_range_um
        slack = RANGE_TOLERANCE * (high - low)
        lowest, highest = (target.min(), target.max()) if target.size else (low, high)
        if lowest < low - slack or highest > high + slack:
            raise ValueError(
                f"the hysteresis output cannot span {lowest:.6g} to {highest:.6g} um; "
                f"the reachable range is {low:.6g} to {high:.6g} um"
            )
        if lowest < low or highest > high:
            target = np.clip(target, low, high)
        memory = self._own(memory)
        voltage, memory.extremes_v, memory.outputs_um, memory.top = invert(
            target,
            ROUNDING * (abs(low) + high - low),
            memory.extremes_v,
            memory.outputs_um,
            memory.top,
            self._grid,
            self._table,
        )
        return voltage

    def gain_um_per_v(self, voltage_v: ArrayLike | None = None) -> tuple[float, float]:
        """Return the smallest and largest gain of the hysteresis, eq. (3.16).

        The gain is that of the secant from negative saturation. At one voltage it is smallest on
        the way up from negative saturation and largest on the way down from positive saturation.
        The voltages are above `voltage_min_v`; by default they are all upper edges of the cells.
        """
        voltage = self.levels_v[1:] if voltage_v is None else np.asarray(voltage_v, dtype=float)
        if not (voltage > self.voltage_min_v).all():
            raise ValueError(f"the gain needs voltages above voltage_min_v, {self.voltage_min_v} V")
        travel = voltage - self.voltage_min_v
        rising = self.everett_um(voltage, self.voltage_min_v)
        falling = self.everett_um(self.voltage_max_v, self.voltage_min_v) - self.everett_um(
            self.voltage_max_v, voltage
        )
        return float((rising / travel).min()), float((falling / travel).max())


def _finite_sequence(sequence: ArrayLike, name: str) -> FloatArray:
    values = np.ascontiguousarray(sequence, dtype=float)
    if values.ndim != 1:
        raise ValueError(f"{name} has {values.ndim} dimensions; give one sequence")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"{name} is not finite at sample {first}; remove or replace it")
    return values
