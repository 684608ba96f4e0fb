# SPDX-License-Identifier: BSD-3-Clause
"""Rasters on the simulated XY stage with the feedback that its model gives, and without."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezo_client.scans import MAX_FEEDBACK_V, Scanned
from piezo_controller.axes.followed_scan import AxesStage, followed_scan
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import StoredScan, stored_scan
from piezo_controller.feedback.axes_design import design_axes_feedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.running_axes_law import RunningAxesLaw
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.coupled_scans.xy_stage import (
    CLOCK_HZ,
    LIMITS,
    NOISE_UM,
    PLANT,
    VOLTAGE_RANGE_V,
    plant_of_study,
    ramp_of_study,
)
from piezo_studies.tables import markdown_table

SIZE_UM, LINES = 20.0, 10
LINES_PER_S = (5.0, 20.0, 100.0)
SETTLING_S = 1.0
"""Least time that a raster is followed before the period that counts."""

DISTURBANCES_HZ = (20.0, 1.0)
"""Bandwidths of the disturbances that laws are designed for: the default, and a slow one."""

GAIN_OFF = 0.05
RAMP_V_PER_S = 2000.0
"""As in the parameter file of the stage."""

HELD_V, HELD_S = 100.0, 60.0
"""Voltage of both axes before a path, and how long it is held: the stage creeps meanwhile."""


@dataclass(frozen=True)
class FeedbackRow:
    """One raster on the stage as it was identified, or with a change."""

    path: str
    change: str
    without: Scanned
    led: list[Scanned]
    """With the law for each of `DISTURBANCES_HZ`."""


def rasters_with_feedback(model: IdentifiedAxes) -> Iterator[FeedbackRow]:
    """Follow rasters with the model as it is, with wrong gains, and after creep."""
    laws = [design_axes_feedback(model.model, load_weights().for_disturbances(each_hz))
            for each_hz in DISTURBANCES_HZ]
    operating_v = model.model.operating_voltage_v
    for lines_per_s in LINES_PER_S:
        planned = stored_scan(scan(model, "raster", size_um=(SIZE_UM, SIZE_UM), rate_hz=lines_per_s,
                              lines=LINES, voltage_range_v=VOLTAGE_RANGE_V))
        off = replace(planned, **{name: operating_v + (1.0 + GAIN_OFF) * (
            getattr(planned, name) - operating_v) for name in ("voltage_v", "begin_voltage_v")})
        for change, played, held_s in (
                ("none", planned, 0.0),
                (f"gains of the model {100 * GAIN_OFF:.0f} % too small", off, 0.0),
                (f"{HELD_S:.0f} s at {HELD_V:.0f} V before", planned, HELD_S)):
            yield FeedbackRow(
                f"{lines_per_s:.0f} lines/s", change,
                *(followed_with_law(played, laws[0], held_s, False),
                  [followed_with_law(played, law, held_s) for law in laws]))


def followed_with_law(planned: StoredScan, law: AxesLaw, held_s: float,
                      acts: bool = True) -> Scanned:
    """Play a path with a law, or without it, tick by tick as the stage does."""
    stage = SimulatedStage(plant_of_study(), 21)
    stage.open()
    if held_s:
        up = ramp_of_study(np.full(len(LIMITS), HELD_V))
        stage.exchange(np.concatenate([up, np.repeat(up[-1:], round(held_s * CLOCK_HZ), axis=0),
                                       up[::-1]]))
    periods = 1 + math.ceil(SETTLING_S * CLOCK_HZ / len(planned.voltage_v))
    described = AxesStage(
        tuple(LIMITS), 1.0 / CLOCK_HZ, law.samples_per_tick,
        np.tile(VOLTAGE_RANGE_V, (len(LIMITS), 1)), np.zeros(len(LIMITS)),
        np.full(len(LIMITS), RAMP_V_PER_S))
    run = followed_scan(planned, described, periods * len(planned.voltage_v), law, MAX_FEEDBACK_V)
    voltage_v = np.concatenate([run.once_voltage_v, *[run.period_voltage_v] * periods])
    missing = run.samples - len(voltage_v)
    voltage_v = np.concatenate([voltage_v, np.tile(voltage_v[-1], (missing, 1))])
    assert run.law is not None
    running, displacement_um = RunningAxesLaw(run.law, law.samples_per_tick), []
    for planned_v in voltage_v.reshape(-1, law.samples_per_tick, len(LIMITS)):
        added_v = running.begin(planned_v) if acts else 0.0
        displacement_um.append(stage.exchange(planned_v + added_v))
        running.take(displacement_um[-1])
    end = run.samples - missing
    return Scanned(Path(PLANT), planned, np.concatenate(displacement_um)[
        end - len(planned.voltage_v):end])


def feedback_table(rows: Iterator[FeedbackRow]) -> str:
    """Return the rows as Markdown: error of the worse axis, and the largest offset."""
    led = [f"with feedback, {hz:.0f} Hz" for hz in DISTURBANCES_HZ]
    heads = [head for each in ("without", *led) for head in (f"{each}: error, %", "offset, um")]
    cells = []
    for row in rows:
        numbers = [number for run in (row.without, *row.led) for number in (
            max(run.error_percent), np.abs(run.offset_um).max())]
        noise = max(100.0 * NOISE_UM / np.ptp(row.without.scan.position_um, axis=0))
        cells.append([row.path, row.change, *(f"{number:.2g}" for number in (*numbers, noise))])
    return markdown_table([f"raster of {SIZE_UM:.0f} um", "change", *heads, "noise, %"], cells)
