# SPDX-License-Identifier: BSD-3-Clause
"""Initial guesses of a Bouc-Wen hysteresis in place of that of a fitted model."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.simulation.simulated_recording import PastVoltages, SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import STEEPEST
from piezo_models.effects.curved_bouc_wen_hysteresis import MOST_CURVED, CurvedBoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel

RELAXATIONS = tuple(np.geomspace(0.03, 3.0, 8))
"""Relaxation voltages that are tried, relative to half the range."""

UNLOADINGS = (0.0, 1.0, 2.0)
"""Factors of unloading that are tried with each of them."""

EXPONENTS = (1.0, 2.0)
"""Exponents that are tried with each pair of these."""

NARROWING = (0.4, 0.8)
"""Decrease of the growth from the middle to the ends of the range, which is tried with each
relaxation voltage, an exponent of 1, and the factors of unloading up to 1."""

LEAST_TAKEN = 1e-3
"""Smallest saturation, relative to the largest possible one."""


Shape = tuple[float, float, float, float]
"""Relaxation relative to half the range, factor of unloading, exponent, and narrowing."""

LIKELY = 3
"""Number of relaxation voltages, the best ones by Dahl's equation, that are tried with others."""


def with_bouc_wen(model: StageModel, line: PreisachModel, parts: Sequence[SimulatedRecording],
                  pasts_v: Sequence[PastVoltages]) -> tuple[StageModel, PastVoltages]:
    """Return a model with the best Bouc-Wen hysteresis of a scan in place of its own, and its past.

    The hysteresis has a curve of the voltage beside it, and behind it, `line` takes the place of
    the loops. The past is the one of `pasts_v` after which hystereses by Dahl's equation explain
    all recordings best.
    """
    ahead = tuple(effect for effect in model.effects if effect.place == "voltage")
    behind = tuple(effect for effect in model.effects if effect.place != "voltage")
    bare = replace(model, hysteresis=line, effects=(*ahead, *behind))
    scans = [_Scan(bare, [part.after(past_v).with_model(bare) for part in parts])
             for past_v in pasts_v]
    by_dahl = [scan.sorted(product(RELAXATIONS, (1.0,), (1.0,), (0.0,))) for scan in scans]
    place = min(range(len(scans)), key=lambda index: by_dahl[index][0].squares)
    likely = [fit.relaxation for fit in by_dahl[place][:LIKELY]]
    best, *_ = scans[place].sorted([*product(likely, UNLOADINGS, EXPONENTS, (0.0,)),
                                    *product(likely, UNLOADINGS[:2], EXPONENTS[:1], NARROWING)])
    return replace(bare, hysteresis=line.scaled(best.gain) if best.gain > 0.0 else line,
                   effects=(*ahead, best.loops, *behind)), pasts_v[place]


@dataclass(frozen=True)
class _Candidate:
    """A hysteresis of a scan."""

    squares: float
    """Squared residual."""
    gain: float
    """Gain of the line behind it."""
    loops: CurvedBoucWenHysteresis

    relaxation: float
    """Relaxation voltage relative to half the range."""


class _Scan:
    """Regressions of recordings on what Bouc-Wen hystereses of several shapes take.

    What the hysteresis takes from the voltage is in proportion to its saturation, so that a
    regression gives the saturation of each shape. The square and the cube of the displacement are
    regressors, too, for the curve beside it. Each recording counts as much as the others: a few
    steps show no shape.
    """

    def __init__(self, bare: StageModel, parts: Sequence[SimulatedRecording]) -> None:
        line = bare.hysteresis
        self._parts = parts
        self._half_v = 0.5 * (line.voltage_max_v - line.voltage_min_v)
        self._middle_v = line.voltage_min_v + self._half_v
        simulated_um = [part.simulate() for part in parts]
        low_um, high_um = line.output_range_um
        self._half_um = 0.5 * (high_um - low_um)
        self._bends = [_joined(parts, [
            ((each - low_um) / self._half_um - 1.0) ** power for each in simulated_um])
            for power in (2, 3)]
        self._without_um = _joined(parts, simulated_um)
        self._measured_um = _joined(parts, [part.measured_um for part in parts])

    def sorted(self, shapes: Iterable[Shape]) -> list[_Candidate]:
        """Return a hysteresis of each shape, that with the least residual first."""
        return sorted(map(self._fitted, shapes), key=lambda candidate: candidate.squares)

    def _fitted(self, shape: Shape) -> _Candidate:
        relaxation, unloading, exponent, narrowing = shape
        relaxation_v = self._half_v * relaxation
        most_v = STEEPEST * relaxation_v / (1.0 + unloading)
        loops = CurvedBoucWenHysteresis(
            most_v, relaxation_v, unloading, exponent,
            growth_curvature_per_v2=-narrowing / self._half_v**2, middle_v=self._middle_v)
        taken_um = self._without_um - _joined(
            self._parts, [part.simulate((loops,)) for part in self._parts])
        gain, lost, *_ = _regression(
            [self._without_um, -taken_um, *self._bends], self._measured_um)[0]
        taken = float(np.clip(lost / gain, LEAST_TAKEN, 1.0)) if gain > 0.0 else LEAST_TAKEN
        (gain, *bends_um), squares = _regression(
            [self._without_um - taken * taken_um, *self._bends], self._measured_um)
        most = 0.25 * MOST_CURVED
        square, cube = np.clip(
            np.array(bends_um) / (max(gain, LEAST_TAKEN) * self._half_um), -most, most)
        return _Candidate(squares, float(gain), replace(
            loops, saturation_v=taken * most_v, curvature_per_v=float(square) / self._half_v,
            cubic_per_v2=float(cube) / self._half_v**2), relaxation)


def _regression(columns: Sequence[FloatArray], target: FloatArray) -> tuple[FloatArray, float]:
    """Return the coefficients of columns that fit a target best, and the squared residual."""
    matrix = np.column_stack(columns)
    sizes = np.asarray(np.linalg.lstsq(matrix, target, rcond=1e-12)[0], dtype=float)
    return sizes, float(np.sum((target - matrix @ sizes) ** 2))


def _joined(parts: Sequence[SimulatedRecording], signals_um: Sequence[FloatArray]) -> FloatArray:
    """Return the good rows of signals but for initial motion; each recording counts the same."""
    return np.concatenate([
        part.without_initial_motion(signal_um) / np.sqrt(part.good.size)
        for part, signal_um in zip(parts, signals_um, strict=True)])
