# SPDX-License-Identifier: BSD-3-Clause
"""Initial guesses of a Bouc-Wen hysteresis in place of that of a fitted model."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import STEEPEST, BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel

RELAXATIONS = tuple(np.geomspace(0.03, 3.0, 12))
"""Relaxation voltages that are tried, relative to half the range."""

UNLOADINGS = (0.0, 0.5, 1.0, 2.0)
"""Factors of unloading that are tried with each of them."""


def with_bouc_wen(model: StageModel, line: PreisachModel,
                  parts: Sequence[SimulatedRecording]) -> StageModel:
    """Return a model with the best Bouc-Wen hysteresis of a scan in place of its own.

    What the hysteresis takes from the voltage is in proportion to its saturation, so that a
    regression gives the saturation of each shape.

    Parameters
    ----------
    line : PreisachModel
        What takes the place of the loops, behind the Bouc-Wen hysteresis.
    parts : sequence of SimulatedRecording
        Recordings; the one with the largest displacement gives the saturation.
    """
    ahead = tuple(effect for effect in model.effects if effect.place == "voltage")
    behind = tuple(effect for effect in model.effects if effect.place != "voltage")
    bare = replace(model, hysteresis=line, effects=(*ahead, *behind))
    widest = max(parts, key=lambda part: float(np.ptp(part.measured_um))).with_model(bare)
    rows, without_um = widest.good, widest.simulate()
    measured_um = widest.measured_um[rows]
    nuisance = widest.nuisance_regressors(rows)
    half_v = 0.5 * (line.voltage_max_v - line.voltage_min_v)
    found = []
    for relaxation, unloading in product(RELAXATIONS, UNLOADINGS):
        relaxation_v = half_v * relaxation
        most_v = STEEPEST * relaxation_v / (1.0 + unloading)
        loops = BoucWenHysteresis(most_v, relaxation_v, unloading)
        columns = np.column_stack([
            without_um[rows], (widest.simulate((loops,)) - without_um)[rows], nuisance])
        sizes, *_ = np.linalg.lstsq(columns, measured_um, rcond=1e-12)
        part = float(np.clip(sizes[1] / sizes[0], 1e-3, 1.0)) if sizes[0] > 0.0 else 1e-3
        left_um = measured_um - columns @ sizes
        found.append((left_um @ left_um, sizes[0], replace(loops, saturation_v=part * most_v)))
    _, gain, loops = min(found, key=lambda entry: entry[0])
    return replace(bare, hysteresis=line.scaled(gain) if gain > 0.0 else line,
                   effects=(*ahead, loops, *behind))
