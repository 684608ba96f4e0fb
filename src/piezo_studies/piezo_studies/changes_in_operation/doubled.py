# SPDX-License-Identifier: BSD-3-Clause
"""Measure how soon a change that doubles the model error is found for different references."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.model_monitor import MonitorSettings, SlowOffset
from piezo_sim.plant.plant_file import PlantConfig
from piezo_studies.changes_in_operation.reference_kinds import CLOCK, plan_of
from piezo_studies.changes_in_operation.watched import WatchedStage, opened, samples
from piezo_studies.tables import markdown_table

CHANGE_S, MEASURED_S, WATCHED_S = 5.07, 2.0, 6.0
"""Time of the change in a run, time afterwards in which the error is twice as large on average, and
time for which the stage is monitored (s)."""


def _with_parameter(plant: PlantConfig, effect: str, parameter: str,
                    factor: float) -> PlantConfig:
    def changed(effects: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(replace(each, **{parameter: factor * getattr(each, parameter)})
                     if each.name == effect else each for each in effects)

    return replace(plant, stage=changed(plant.stage), sensor=changed(plant.sensor))


CHANGES: dict[str, Callable[[PlantConfig], PlantConfig]] = {
    "gain": lambda plant: _with_parameter(
        plant, "generalised_plays", "instant_gain_um_per_v", 1.01),
    "width of the hysteresis": lambda plant: _with_parameter(
        plant, "generalised_plays", "threshold_scale_v", 1.02),
    "lag of the sensor": lambda plant: _with_parameter(plant, "distributed_lag", "lag_s", 1.2),
    "frequencies of the modes": lambda plant: _with_parameter(
        plant, "clamped_beam", "length_m", 0.99),
}
"""Changes of the plant `beam`, by name; their effect is scaled until the error doubles."""


@dataclass(frozen=True)
class Doubling:
    """The report of the monitor on one change."""

    kind: str
    change: str
    """Kind of the reference, and a key of `CHANGES`."""
    before_um: float
    after_um: float
    """RMS of the error (um) without the change and with it."""
    found_s: float
    """Time from the change to the first report; nan if there was none."""
    early: bool
    """Whether a change was reported before it happened."""


def watch_doubling(watched: WatchedStage, kind: str, change: str) -> Doubling:
    """Track a reference on a copy of a stage that changes so that the model's error doubles."""
    voltage_v = plan_of(kind, watched.identified.model, 0).voltage_v(
        0, samples(CHANGE_S + WATCHED_S))
    unchanged, changed = (
        np.asarray(opened(plant, watched.seed).exchange(voltage_v))
        for plant in (watched.plant, CHANGES[change](watched.plant)))
    residual_um = unchanged - watched.identified.model.simulate(voltage_v, CLOCK.sample_period_s)
    added_um = np.where(np.arange(voltage_v.size) >= samples(CHANGE_S), changed - unchanged, 0.0)
    before_um = error_um(residual_um)

    def excess(logarithm: float) -> float:
        return float(np.log(error_um(residual_um + np.exp(logarithm) * added_um)
                            / (2.0 * before_um)))

    scale = float(np.exp(brentq(excess, -12.0, 12.0)))
    begin_s = watched.next_sample / CLOCK.sample_rate_hz
    raised_s = [found.at_s - begin_s - CHANGE_S
                for found in watched.copy().play(voltage_v, scale * added_um)]
    after_s = [at_s for at_s in raised_s if at_s > 0.0]
    return Doubling(kind, change, before_um, error_um(residual_um + scale * added_um),
                    after_s[0] if after_s else np.nan, len(after_s) < len(raised_s))


def error_um(residual_um: FloatArray) -> float:
    """Return the RMS error in the time `MEASURED_S` after the change, as the monitor computes it.

    The residual, (N,), is that from the beginning of a run on.
    """
    size, slow, squares = samples(MonitorSettings().block_s), SlowOffset(), []
    for begin in range(size, samples(CHANGE_S + MEASURED_S), size):
        block_um = residual_um[begin : begin + size]
        departure_um = slow.take(float(block_um.mean()))
        if begin >= samples(CHANGE_S):
            squares.append(float(np.var(block_um)) + departure_um**2)
    return float(np.sqrt(np.mean(squares)))


def table(rows: list[tuple[str, list[Doubling], list[Doubling]]]) -> str:
    """Return as Markdown each change, with its results after hours and in the first run."""
    return markdown_table(
        ("what changes", "after hours: found in 2 s", "median", "slowest",
         "in the first run: found in 2 s", "median", "slowest"),
        [(change, *_cells(later), *_cells(first)) for change, later, first in rows])


def _cells(doublings: list[Doubling]) -> tuple[str, str, str]:
    found_s = np.array([each.found_s for each in doublings])
    soon = np.count_nonzero(found_s <= MEASURED_S)
    slowest = (f"{found_s.max():.1f} s" if np.isfinite(found_s).all()
               else f"{np.count_nonzero(np.isnan(found_s))} not in {WATCHED_S:g} s")
    median_s = np.median(np.where(np.isnan(found_s), np.inf, found_s))
    return f"{soon} of {found_s.size}", f"{median_s:.1f} s", slowest
