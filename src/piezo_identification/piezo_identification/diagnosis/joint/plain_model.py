# SPDX-License-Identifier: BSD-3-Clause
"""The simplest model of some recordings, a line and one mode, and the effects that it needs.

A model that was identified with nonlinear mechanics has compensated for them by hysteresis, creep
and further modes, each of which is valid only where it was fitted. If a line and the loudest mode
fit nearly as well, effects in addition to these are a simpler explanation of the same recordings.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_identification.diagnosis.comparison.selection import select_effects
from piezo_identification.diagnosis.joint.alternatives import Alternative, fits_of_free_model
from piezo_identification.diagnosis.joint.probabilities import ExpectedErrors
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.joint_fit import JointProblem
from piezo_identification.fitting.regression import first_regression
from piezo_identification.fitting.structure_search import loudest_mode
from piezo_identification.fitting.whole_model import WholeFit, WholeModel
from piezo_models.cascade import StageModel
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

LARGEST_RESIDUAL = 2.0
"""Largest residual relative to that of the given model for which a simple model is worth a
comparison of effects: hysteresis, creep and further modes then explain less than half of the
misfit."""

STEPS = 20
"""Largest number of steps of its fit."""


def is_plain(model: StageModel) -> bool:
    """Return whether a model already is just a line and a mode."""
    return not (model.hysteresis.density_um_per_v2.any() or model.creep.poles_rad_per_s
                or model.dynamics.time_constant_s > 0.0 or model.effects_at("modes")
                or len(model.dynamics.mode_frequencies_rad_per_s) > 1)


def plain_model(model: StageModel, recordings: Sequence[Recording],
                residual_um: float) -> StageModel | None:
    """Fit a line and the loudest mode of a model, with a held voltage and with a smooth one.

    The recordings have the sign of the model, and marked outliers. Return the better one, or None
    if the model has no mode, or both fit far worse than it does.
    """
    if model.dynamics.is_static and not model.effects_at("modes"):
        return None
    period_s = float(min(each.sample_periods_s.min() for each in recordings))
    bare = StageModel(_line(model, recordings), CreepDynamics(), loudest_mode(model, period_s))
    problem = WholeModel(bare, recordings, [0.0] * len(recordings))
    starts: list[tuple[StageModel, float | None]] = [(bare, None)]
    if problem.is_sampled:
        starts.append((replace(bare, effects=(BandLimitedVoltage(),)), 0.5 * period_s))
    best = min((_fitted(problem, *start) for start in starts), key=_residual_rms_um)
    is_close = _residual_rms_um(best) < LARGEST_RESIDUAL * residual_um
    return best.delayed_model if is_close else None


def fits_of_plain_model(plain: StageModel, new: Sequence[Recording], old: Sequence[Recording],
                        expected: Callable[[JointProblem], ExpectedErrors],
                        report: Callable[[str, float], None],
                        ) -> tuple[JointProblem, list[Alternative]]:
    """Select the effects that recordings show with a simple model; refit all, and some of them."""
    dataset = simulate_recordings(plain, [*new, *old])
    selection = select_effects(first_regression(dataset), report)
    problem = JointProblem(plain, new, old, simulated=dataset.simulated)
    sets = [fit.effects for fit in (selection.end, *selection.parts)]
    return problem, fits_of_free_model(problem, sets, expected(problem))


def _fitted(problem: WholeModel, model: StageModel, delay_s: float | None) -> WholeFit:
    """Fit a model whose delay must not be negative, because rows are read as in the given one."""
    fit = problem.fit(model, delay_s, STEPS)
    return fit if (fit.delay_s or 0.0) >= 0.0 else problem.fit(fit.model, None, STEPS)


def _line(model: StageModel, recordings: Sequence[Recording]) -> PreisachModel:
    """Return a line over the voltages of the recordings, with the gain of a model."""
    low_v, high_v = model.hysteresis.voltage_min_v, model.hysteresis.voltage_max_v
    low_um, high_um = model.hysteresis.output_range_um
    gain_um_per_v = (high_um - low_um) / (high_v - low_v)
    low_v = min(low_v, *(float(np.min(each.voltage_v)) for each in recordings))
    high_v = max(high_v, *(float(np.max(each.voltage_v)) for each in recordings))
    return PreisachModel.line(low_v, high_v, gain_um_per_v, low_um)


def _residual_rms_um(fit: WholeFit) -> float:
    """Return the RMS residual of the fitted rows."""
    return float(np.sqrt(np.mean(np.concatenate([fitted for fitted, _ in fit.residual_um]) ** 2)))
