# SPDX-License-Identifier: BSD-3-Clause
"""Limits of the voltage that may reach the amplifier."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from piezo_stage_driver.safety.sample_kernels import (
    FLAG_RANGE_LIMITED,
    FLAG_SLEW_LIMITED,
    columns,
    hold_within,
)

__all__ = ["FLAG_RANGE_LIMITED", "FLAG_SLEW_LIMITED", "AxesLimits", "FeedbackLimits",
           "LimitError", "Limits", "VoltageLimits"]


class LimitError(ValueError):
    """A voltage that the stage must not play."""


class Limits(Protocol):
    """Limits that the stage enforces for every client: `VoltageLimits`, or `AxesLimits`."""

    @property
    def slew_v_per_s(self) -> Any:
        """Return the slew limit (V/s), of each axis if there are several."""

    def check_rest(self, rest_voltage_v: Any) -> None:
        """Raise `LimitError` if a rest voltage is outside the range."""

    def check(self, voltage_v: np.ndarray, sample_period_s: float, previous_v: Any = None) -> None:
        """Raise `LimitError` if voltages leave the range or jump."""

    def check_start(self, voltage_v: Any, present_v: Any, largest_step_v: Any) -> None:
        """Raise `LimitError` if the stage would have to jump to a first voltage."""

    def apply(self, voltage_v: np.ndarray, previous_v: Any,
              sample_period_s: float) -> tuple[np.ndarray, int]:
        """Return voltages held within the limits, and the flags of the limits that took effect."""


@dataclass(frozen=True)
class VoltageLimits:
    """Range and slew rate that the stage enforces for every client."""

    minimum_v: float
    maximum_v: float
    """Range (V), both ends allowed."""
    slew_v_per_s: float
    """Largest change from one sample of the clock to the next, per sample period (V/s)."""

    def __post_init__(self) -> None:
        if not self.minimum_v < self.maximum_v:
            raise LimitError(f"the voltage range [{self.minimum_v}, {self.maximum_v}] V is empty: "
                             "let minimum_voltage_v be below maximum_voltage_v")

    def check_rest(self, rest_voltage_v: float) -> None:
        """Raise `LimitError` if a rest voltage is outside the range."""
        if not self.minimum_v <= rest_voltage_v <= self.maximum_v:
            raise LimitError(f"the rest voltage is {rest_voltage_v:g} V, outside "
                             f"[{self.minimum_v:g}, {self.maximum_v:g}] V: "
                             "set rest_voltage_v within it")

    def check(self, voltage_v: npt.ArrayLike, sample_period_s: float,
              previous_v: float | None = None) -> None:
        """Raise `LimitError` for the first sample, (n,), that leaves the range or jumps.

        A change takes place within one sample period (s); the first sample may follow a previous
        voltage.
        """
        voltage_v = np.asarray(voltage_v, dtype=float)
        if voltage_v.size == 0:
            raise LimitError("the voltage sequence is empty: send at least one sample")
        bad = np.flatnonzero(~np.isfinite(voltage_v))
        if bad.size:
            raise LimitError(f"voltage sample {bad[0]} is not a finite number: "
                             "send finite voltages only")
        bad = np.flatnonzero((voltage_v < self.minimum_v) | (voltage_v > self.maximum_v))
        if bad.size:
            raise LimitError(
                f"voltage sample {bad[0]} is {voltage_v[bad[0]]:g} V, outside "
                f"[{self.minimum_v:g}, {self.maximum_v:g}] V: scale or shift the sequence")
        steps = np.diff(voltage_v if previous_v is None else np.r_[previous_v, voltage_v])
        largest_step_v = self.slew_v_per_s * sample_period_s
        bad = np.flatnonzero(np.abs(steps) > largest_step_v * (1 + 1e-9))
        if bad.size:
            at = bad[0] + (previous_v is None)
            raise LimitError(
                f"the voltage jumps by {abs(steps[bad[0]]):.4g} V to sample {at}, more than the "
                f"{largest_step_v:.4g} V that the slew limit allows: make the change slower")

    def check_start(self, voltage_v: float, present_v: float, largest_step_v: float) -> None:
        """Raise `LimitError` if the stage would have to jump to a first voltage."""
        if abs(voltage_v - present_v) > largest_step_v:
            raise LimitError(
                f"the voltage jumps by {abs(voltage_v - present_v):.4g} V to sample 0, more than "
                f"the {largest_step_v:.4g} V that the ramps go in one tick: "
                "begin at the present voltage")

    def apply(self, voltage_v: np.ndarray, previous_v: float,
              sample_period_s: float) -> tuple[np.ndarray, int]:
        """Hold voltages, (n,), within the limits; NaN is replaced by the voltage before it.

        The first sample follows a previous voltage. Also returned are ``FLAG_RANGE_LIMITED`` and
        ``FLAG_SLEW_LIMITED`` if they took effect.
        """
        return hold_within(np.asarray(voltage_v, dtype=float), previous_v, self.minimum_v,
                           self.maximum_v, self.slew_v_per_s * sample_period_s * (1 + 1e-9))


class AxesLimits:
    """The limits of several axes; the message of an error names the axis.

    The methods are those of `VoltageLimits`, for voltages of all axes in the order of the names:
    shape (n, axes), or (axes,) instead of a single voltage.
    """

    def __init__(self, by_axis: Mapping[str, VoltageLimits]) -> None:
        self._by_axis = dict(by_axis)

    @property
    def slew_v_per_s(self) -> np.ndarray:
        """Return the slew limit of each axis, shape (axes,)."""
        return np.array([limits.slew_v_per_s for limits in self._by_axis.values()])

    def check_rest(self, rest_voltage_v: np.ndarray) -> None:
        """Raise `LimitError` if a rest voltage is outside the range."""
        for (axis, limits), rest_v in zip(self._by_axis.items(), rest_voltage_v, strict=True):
            with _named(axis):
                limits.check_rest(rest_v)

    def check(self, voltage_v: np.ndarray, sample_period_s: float,
              previous_v: np.ndarray | None = None) -> None:
        """Raise `LimitError` if voltages leave the range or jump."""
        if voltage_v.shape[1:] != (len(self._by_axis),):
            raise LimitError(f"the voltages have the shape {voltage_v.shape}: give a column for "
                             f"{' and '.join(self._by_axis)}")
        for at, (axis, limits) in enumerate(self._by_axis.items()):
            with _named(axis):
                limits.check(voltage_v[:, at], sample_period_s,
                             None if previous_v is None else previous_v[at])

    def check_start(self, voltage_v: np.ndarray, present_v: np.ndarray,
                    largest_step_v: np.ndarray) -> None:
        """Raise `LimitError` if the stage would have to jump to the first voltages."""
        for (axis, limits), *of_axis_v in zip(
                self._by_axis.items(), voltage_v, present_v, largest_step_v, strict=True):
            with _named(axis):
                limits.check_start(*of_axis_v)

    def apply(self, voltage_v: np.ndarray, previous_v: np.ndarray,
              sample_period_s: float) -> tuple[np.ndarray, int]:
        """Hold voltages within the limits; return the combined flags of all axes."""
        limited_v, flags = zip(*(
            limits.apply(of_axis_v, last_v, sample_period_s) for limits, of_axis_v, last_v in zip(
                self._by_axis.values(), columns(voltage_v), previous_v, strict=True)), strict=True)
        return np.column_stack(limited_v), reduce(or_, flags)


@contextmanager
def _named(axis: str) -> Iterator[None]:
    """Prefix the message of a `LimitError` with the name of an axis."""
    try:
        yield
    except LimitError as refused:
        raise LimitError(f"{axis}: {refused}") from None


@dataclass(frozen=True)
class FeedbackLimits:
    """Limits of a single feedback answer of any client."""

    maximum_v: float = math.inf
    """An answer above this, of either sign, does not act (V)."""
    maximum_step_v: float = math.inf
    """Largest change of the feedback from one tick to the next (V)."""
    patience: int = 3
    """Largest number of consecutive limited answers; more stop the stage."""

    def apply(self, voltage_v: float, previous_v: float) -> tuple[float, bool]:
        """Return the feedback (V) that an answer may cause, and whether it was limited.

        The previous feedback is that which acts at present.
        """
        if not abs(voltage_v) <= self.maximum_v:
            return previous_v, True
        step_v = voltage_v - previous_v
        if abs(step_v) <= self.maximum_step_v:
            return voltage_v, False
        return previous_v + math.copysign(self.maximum_step_v, step_v), True

