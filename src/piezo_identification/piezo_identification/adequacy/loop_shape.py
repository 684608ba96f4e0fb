# SPDX-License-Identifier: BSD-3-Clause
"""Refuse loops that no Preisach model with positive relays can represent.

Each relay switches on as the voltage rises and off as it falls. Thus the displacement never moves
against the voltage, falling branches lie above rising ones, and minor loops close.

Creep and dynamics violate these conditions, too, and are removed before the test. If they were
estimated badly, their removal can distort the loops. Loops are therefore refused only if many of
their branches violate a condition both as measured and with creep and dynamics removed.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.means import means_in_bins
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.settling import first_settled
from piezo_identification.conditioning.waveforms import REVERSAL, played, turning_points
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_identification.estimators.hysteresis.density_fit import hysteresis_output_um
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class LoopSettings:
    """Tolerances for drift, noise and unknown creep in loops."""

    long_branch: float = 0.2
    """Shortest branch whose shape is tested, as a fraction of the voltage range."""
    bins: int = 40
    """Number of bins of a branch in which samples are averaged."""
    against: float = 0.05
    """Largest movement against the voltage, as a fraction of the displacement range."""
    clockwise: float = 0.01
    """Largest distance of a falling branch below a rising one, as a fraction of the displacement
    range."""
    open_loop: float = 0.25
    """Largest gap of a minor loop, and largest step between rows of a branch, as a fraction of its
    swing."""
    fewest_minor_loops: int = 3
    """Fewest minor loops for which closing is tested."""
    many: float = 0.25
    """Share of the branches from which loops are refused. Fewer may ring as measured."""


SETTINGS = LoopSettings()


@dataclass(frozen=True)
class Violation:
    """A condition that loops violate."""

    found: str
    """What was found, and where."""
    advice: str

    share: float = 1.0
    """Share of the branches that violate it."""


@dataclass(frozen=True, eq=False)
class Branch:
    """The motion between two reversals, averaged in bins of the voltage."""

    voltage_v: FloatArray
    output_um: FloatArray
    """Voltage and output in the order of time, (B,)."""

    @property
    def rises(self) -> bool:
        """Whether the voltage rises."""
        return bool(self.voltage_v[-1] > self.voltage_v[0])

    @property
    def against_um(self) -> tuple[float, float]:
        """Largest movement against the voltage, and the voltage at which it ends."""
        along_um = self.output_um if self.rises else -self.output_um
        below_um = np.maximum.accumulate(along_um) - along_um
        worst = int(np.argmax(below_um))
        return float(below_um[worst]), float(self.voltage_v[worst])


@dataclass(frozen=True, eq=False)
class Loops:
    """Samples of a recording between reversals of its voltage."""

    path: str

    voltage_v: FloatArray
    output_um: FloatArray
    """Shape (N,)."""
    points: NDArray[np.intp]
    """Samples at which the voltage reverses, and the first and last sample."""

    @property
    def branches(self) -> list[Branch]:
        """Branches that are long enough to test their shape, and do not jump."""
        long_v = SETTINGS.long_branch * float(np.ptp(self.voltage_v))
        return [
            _binned(self.voltage_v[start : end + 1], self.output_um[start : end + 1])
            for start, end in pairwise(self.points)
            if abs(self.voltage_v[end] - self.voltage_v[start]) > long_v
            and not _jumps(np.diff(self.voltage_v[start : end + 1]),
                           self.voltage_v[end] - self.voltage_v[start])]


def refuse_impossible_loops(
    recording: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    delay_s: float = 0.0,
) -> list[str]:
    """Refuse a recording of loops that no Preisach model can represent.

    It is not tested if it is too fast to be quasi-static. Raise ValueError if the displacement
    moves against the voltage, loops are clockwise, or minor loops do not close, both as measured
    and with creep, dynamics and delay removed, on many branches. Return a sentence on each
    violation that appears on few branches or none as measured.
    """
    part = played(recording)
    used = good_samples(part) & (
        np.arange(part.time_s.size) >= first_settled(dynamics, part.time_s))
    voltage_v = np.asarray(part.voltage_v, dtype=float)[used]
    range_v = float(np.ptp(voltage_v))
    points = turning_points(voltage_v, REVERSAL * range_v)
    if np.median(np.diff(part.time_s[used][points])) < WAVEFORM.slow_branch_s:
        return []
    without, measured = (
        Loops(str(part.path), voltage_v, np.asarray(output_um)[used], points) for output_um in (
            hysteresis_output_um(part, creep, dynamics, delay_s), part.displacement_um))
    doubts = []
    for violation_of in (_against, _clockwise, _open_loops):
        violation, shown = violation_of(without), violation_of(measured)
        if violation is None:
            continue
        if shown is not None and min(violation.share, shown.share) >= SETTINGS.many:
            raise ValueError(f"{violation.found}: {violation.advice}")
        doubts.append(
            f"once creep and dynamics are taken out, {violation.found}; as measured the loops show "
            "it on few branches or none, so that creep or dynamics are not those of these loops, "
            "and the error of the hysteresis holds theirs")
    return doubts


def _against(loops: Loops) -> Violation | None:
    range_um = float(np.ptp(loops.output_um))
    found = [(branch, *branch.against_um) for branch in loops.branches]
    wrong = [entry for entry in found if entry[1] > SETTINGS.against * range_um]
    if not wrong:
        return None
    ways = {branch.rises for branch, *_ in wrong}
    branch, against_um, at_v = max(wrong, key=lambda entry: entry[1])
    name = "a butterfly loop" if len(ways) == 2 else "no loop that is monotone in the voltage"
    moves = "falls" if branch.rises else "rises"
    return Violation(
        f"{loops.path} holds {name}: the displacement {moves} by {against_um:.3g} um, to "
        f"{at_v:.4g} V, while the voltage {'rises' if branch.rises else 'falls'} (on {len(wrong)} "
        f"of {len(found)} branches), which no Preisach model can do",
        "keep the voltage on the side of that turn on which the displacement follows it, or look "
        "for drift and wrong columns", len(wrong) / len(found))


def _clockwise(loops: Loops) -> Violation | None:
    range_um = float(np.ptp(loops.output_um))
    widths_um = [width for pair in pairwise(loops.branches)
                 if (width := _width_um(*pair)) is not None]
    if not widths_um or np.median(widths_um) >= -SETTINGS.clockwise * range_um:
        return None
    return Violation(
        f"{loops.path} holds loops that are run through clockwise, {-np.median(widths_um):.3g} "
        "um wide: falling branches lie below rising ones, so that the displacement leads the "
        "voltage, which no Preisach model can do",
        "look for rows that are shifted, or for a voltage that is that of a controller")


def _width_um(first: Branch, second: Branch) -> float | None:
    """Return the mean height of the falling branch above the rising one where both overlap."""
    if first.rises == second.rises:
        return None
    low_v = max(first.voltage_v.min(), second.voltage_v.min())
    high_v = min(first.voltage_v.max(), second.voltage_v.max())
    if low_v >= high_v:
        return None
    level_v = np.linspace(low_v, high_v, SETTINGS.bins)
    up, down = (first, second) if first.rises else (second, first)
    return float(np.mean(
        np.interp(level_v, down.voltage_v[::-1], down.output_um[::-1])
        - np.interp(level_v, up.voltage_v, up.output_um)))


def _open_loops(loops: Loops) -> Violation | None:
    """Return whether minor loops do not return to the displacement where they began."""
    voltage_v, output_um, points = loops.voltage_v, loops.output_um, loops.points
    open_parts = []
    for origin, turn, end in zip(points[:-2], points[1:-1], points[2:], strict=True):
        # The branch from `turn` passes the voltage of `origin` if it is long enough.
        back = voltage_v[turn : end + 1]
        sign = np.sign(voltage_v[origin] - voltage_v[turn])
        passed = np.flatnonzero(sign * (back - voltage_v[origin]) >= 0.0)
        if origin == 0 or passed.size == 0 or passed[0] == 0:
            continue
        after = turn + passed[0]
        step_v = voltage_v[after] - voltage_v[after - 1]
        if _jumps(step_v, voltage_v[turn] - voltage_v[origin]):
            continue
        part = (voltage_v[origin] - voltage_v[after - 1]) / step_v
        returned_um = (1.0 - part) * output_um[after - 1] + part * output_um[after]
        swing_um = abs(output_um[turn] - output_um[origin])
        open_parts.append((returned_um - output_um[origin]) / max(swing_um, np.finfo(float).tiny))
    if len(open_parts) < SETTINGS.fewest_minor_loops:
        return None
    typical = float(np.median(open_parts))
    if abs(typical) <= SETTINGS.open_loop:
        return None
    return Violation(
        f"{loops.path} holds minor loops that do not close: the displacement is "
        f"{100 * typical:+.0f} % of their swing off where they began, so that a former extreme "
        "does not wipe out later extremes, which no Preisach model can do",
        "look for drift, or give the creep")


def _jumps(steps_v: FloatArray, swing_v: float) -> bool:
    """Return whether rows are so far apart that they do not show the motion between them.

    The row of a jump may also show the displacement before it.
    """
    return bool(np.max(np.abs(steps_v)) > SETTINGS.open_loop * abs(swing_v))


def _binned(voltage_v: FloatArray, output_um: FloatArray) -> Branch:
    """Return means in bins of the voltage; the samples themselves if there are few."""
    if voltage_v.size <= 2 * SETTINGS.bins:
        return Branch(voltage_v, output_um)
    edges_v = np.linspace(voltage_v[0], voltage_v[-1], SETTINGS.bins + 1)
    rises = edges_v[-1] > edges_v[0]
    number = np.searchsorted(edges_v, voltage_v) if rises else np.searchsorted(
        -edges_v, -voltage_v)
    number = np.clip(number - 1, 0, SETTINGS.bins - 1)
    return Branch(*means_in_bins(number, voltage_v, output_um))
