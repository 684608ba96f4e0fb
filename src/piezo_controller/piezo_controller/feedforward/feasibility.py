# SPDX-License-Identifier: BSD-3-Clause
"""Errors and checks for a reference that the amplifier cannot follow."""

import math
from collections.abc import Callable

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import Watch
from piezo_models.hysteresis.preisach import PreisachModel

BISECTIONS = 14
VOLTAGE = "voltages", "V"
DISPLACEMENT = "displacements", "um"


class UnreachableReference(ValueError):
    """A reference that the amplifier cannot follow; the message gives a feasible amplitude.

    `reachable_um` is the largest feasible peak-to-peak amplitude of the reference, scaled about its
    mean; zero if the mean itself is out of reach, NaN if it was not searched for.
    """

    def __init__(self, message: str, reachable_um: float) -> None:
        super().__init__(message)
        self.reachable_um = reachable_um


class Infeasible(Exception):
    """The reason why the amplifier cannot follow a reference."""


def check_range(values: FloatArray, lowest: float, highest: float,
                quantity: tuple[str, str]) -> None:
    """Raise `Infeasible` if values of a quantity, such as `VOLTAGE`, are beyond the limits."""
    if values.min() < lowest or values.max() > highest:
        name, unit = quantity
        raise Infeasible(f"it takes {name} from {values.min():.4g} to {values.max():.4g} "
                         f"{unit}, available are {lowest:.4g} to {highest:.4g} {unit}")


def check_hysteresis_range(hysteresis_um: FloatArray, hysteresis: PreisachModel) -> None:
    """Raise `Infeasible`, with the voltages that it would need, for an output out of reach."""
    low_um, high_um = hysteresis.output_range_um
    needed_um = np.array([hysteresis_um.min(), hysteresis_um.max()])
    if needed_um[0] < low_um or needed_um[1] > high_um:
        low_v, high_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
        from_v, to_v = low_v + (needed_um - low_um) * (high_v - low_v) / (high_um - low_um)
        raise Infeasible(f"it takes voltages from about {from_v:.3g} to {to_v:.3g} V, available "
                         f"are {low_v:.4g} to {high_v:.4g} V")


def check_slew(voltage_v: FloatArray, sample_period_s: float, slew_limit_v_per_s: float) -> None:
    """Raise `Infeasible` if a voltage changes too fast."""
    slew_v_per_s = np.abs(np.diff(voltage_v)).max(initial=0.0) / sample_period_s
    if slew_v_per_s > slew_limit_v_per_s:
        raise Infeasible(f"it takes {slew_v_per_s:.3g} V/s, more than the slew limit of "
                         f"{slew_limit_v_per_s:.3g} V/s")


def unreachable(plan: Callable[[float, float], object], reference_um: FloatArray,
                output_range_um: tuple[float, float], reason: Infeasible,
                watch: Watch | None = None) -> UnreachableReference:
    """Return the error with the largest feasible amplitude, which is found by bisection.

    ``plan(centre_um, scale)`` plans the reference scaled about a centre, and raises `Infeasible`;
    of the reference, a part with its mean and its extremes suffices.
    """
    mean_um, travel_um = reference_um.mean(), np.ptp(reference_um)

    def feasible(scale: float) -> bool:
        try:
            plan(mean_um, scale)
        except Infeasible:
            return False
        return True

    if not feasible(0.0):
        low_um, high_um = output_range_um
        return UnreachableReference(
            f"the amplifier cannot hold the reference's mean of {mean_um:.4g} um: "
            f"the stage reaches about {low_um:.4g} to {high_um:.4g} um", 0.0)
    reachable_um = rounded_down(largest_part(feasible, watch) * travel_um)
    return UnreachableReference(
        f"the amplifier cannot follow {travel_um:.4g} um peak to peak about {mean_um:.4g} um: "
        f"{reason}; {reachable_um:g} um peak to peak is within reach", reachable_um)


def largest_part(feasible: Callable[[float], bool], watch: Watch | None = None) -> float:
    """Return the largest part between 0, which is feasible, and 1, which is not, by bisection."""
    reachable, beyond = 0.0, 1.0
    for bisection in range(BISECTIONS):
        if watch:
            watch(bisection / BISECTIONS)
        middle = (reachable + beyond) / 2.0
        reachable, beyond = (middle, beyond) if feasible(middle) else (reachable, middle)
    return reachable


def rounded_down(value: float) -> float:
    """Round down to three significant digits."""
    if value <= 0:
        return 0.0
    digits = 2 - math.floor(math.log10(value))
    return math.floor(value * 10**digits) / 10**digits
