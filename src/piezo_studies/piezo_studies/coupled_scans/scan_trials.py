# SPDX-License-Identifier: BSD-3-Clause
"""Paths and sines on the simulated XY stage: no inverse, that of the model, and learned voltages.

All errors are by the sensors, with the offset removed; the noise stands beside them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_client.scan_learning import learned
from piezo_client.scans import Scanned
from piezo_controller.axes.path_plan import PathPlan
from piezo_controller.axes.scan import scan
from piezo_controller.axes.scan_path import ScanPath
from piezo_controller.axes.stored_scan import StoredScan, stored_scan
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_studies.coupled_scans.xy_stage import (
    CLOCK_HZ,
    LIMITS,
    NOISE_UM,
    VOLTAGE_RANGE_V,
    followed,
)

LEARNED_RUNS = 8
BELOW_HZ = (50.0, 150.0, 250.0)
SINE_UM = 5.0
"""Amplitude of the sine in x."""

MEAN_OF_S = 0.5
"""Time over which the periods of a sine are averaged, whose noise would hide what y does."""

TURNS = 0.4
"""Part of a line's time in which it turns at 500 lines a second. At 0.2, 20 um are out of reach of
the amplifiers."""

BEYOND = 1.5
"""Rate of the fast figures over the frequency of the lowest mode."""


@dataclass(frozen=True)
class Row:
    """One path or frequency."""

    asked: str

    none: float
    inverse: float
    learned: float
    noise: float
    """Error of the worse axis in percent of its travel, or motion of y over that of x in dB:
    without an inverse, by the coupled inverse of the model, by learned voltages, and what the
    noise of the sensors makes of it alone."""
    wanted: float
    runs: int
    """Runs that were played to learn."""


def paths(model: IdentifiedAxes) -> list[Row]:
    """Follow rasters of 20 um, and figures of 10 um beyond the lowest mode."""
    fast_hz = min(1000.0, BEYOND * lowest_mode_hz(model))
    figure: dict[str, Any] = {"size_um": (10.0, 10.0), "rate_hz": fast_hz, "lines": 10}
    rows = []
    for text, wanted, kind, fields in (
            ("raster of 20 um, 100 lines/s", 0.05, "raster",
             {"size_um": (20.0, 20.0), "rate_hz": 100.0, "lines": 10}),
            ("raster of 20 um, 500 lines/s, both directions", 0.2, "raster",
             {"size_um": (20.0, 20.0), "rate_hz": 500.0, "lines": 10, "both_directions": True,
              "flyback_s": TURNS / 500.0}),
            (f"spiral of 10 um, {fast_hz:.0f} Hz", 0.1, "spiral", figure),
            (f"Lissajous figure of 10 um, {fast_hz:.0f} Hz", 0.1, "lissajous", figure),
            (f"rosette of 10 um, {fast_hz:.0f} Hz", 0.1, "rosette", figure)):
        plan = scan(model, kind, voltage_range_v=VOLTAGE_RANGE_V, **fields)
        travel_um = np.ptp(plan.path.position_um, axis=0)
        rows.append(_row(text, wanted, plan, _error_percent, float(
            max(100.0 * NOISE_UM / travel_um))))
    return rows


def sines(model: IdentifiedAxes) -> list[Row]:
    """Move x by a sine and let y rest, below the lowest mode and at it."""
    mode_hz = lowest_mode_hz(model)
    rows = []
    for frequency_hz, wanted in (*((each, -60.0) for each in BELOW_HZ), (mode_hz, -40.0)):
        samples = round(CLOCK_HZ / frequency_hz)
        mean_of = round(MEAN_OF_S * CLOCK_HZ / samples)
        plan = scan(model, _sine(model, samples), voltage_range_v=VOLTAGE_RANGE_V)
        text = f"{CLOCK_HZ / samples:.4g} Hz" + (
            ", the lowest mode" if frequency_hz == mode_hz else "")
        noise = 20.0 * np.log10(NOISE_UM[1] / np.sqrt(mean_of) / (SINE_UM / np.sqrt(2.0)))
        rows.append(_row(text, wanted, plan, _coupling_db, float(noise), mean_of))
    return rows


def lowest_mode_hz(model: IdentifiedAxes) -> float:
    """Return the frequency of the lowest mode of a model."""
    poles = model.model.poles_rad_per_s
    return float(np.abs(poles[poles.imag > 0.0]).min() / (2.0 * np.pi))


def _sine(model: IdentifiedAxes, samples: int) -> ScanPath:
    centre_um = model.model.operating_displacement_um
    turn = 2.0 * np.pi * np.arange(samples) / samples
    moved_um = np.column_stack([SINE_UM * np.cos(turn), 0.0 * turn])
    return ScanPath("sine", tuple(LIMITS), 1.0 / CLOCK_HZ, centre_um + moved_um,
                    np.zeros(samples, dtype=np.int64), CLOCK_HZ / samples,
                    np.array([2.0 * SINE_UM, 0.0]), centre_um)


def _row(text: str, wanted: float, plan: PathPlan, measure: Callable[[Scanned], float],
         noise: float, mean_of: int = 1) -> Row:
    """Play a plan in each way; of what is learned, the best run counts."""
    planned = stored_scan(plan)
    periods = 2 + round(MEAN_OF_S * CLOCK_HZ / len(plan.voltage_v))

    def play(each: StoredScan) -> Scanned:
        return followed(each, periods, mean_of)

    done = [play(planned)]
    for _ in range(LEARNED_RUNS):
        done.append(play(learned(done[-1], plan.model)))
        if max(done[-1].error_percent) > max(done[-2].error_percent):
            break
    best = min(done, key=lambda run: max(run.error_percent))
    plain = stored_scan(plan.without_inverse())
    return Row(text, measure(play(plain)), measure(done[0]), measure(best), noise, wanted,
               len(done) - 1)


def _error_percent(run: Scanned) -> float:
    return float(max(run.error_percent))


def _coupling_db(run: Scanned) -> float:
    x_um, y_um = np.std(run.displacement_um, axis=0)
    return float(20.0 * np.log10(y_um / x_um))


TABLES: dict[str, tuple[str, str, Callable[[IdentifiedAxes], list[Row]]]] = {
    "paths": ("worse axis", "%", paths), "cross-coupling": ("y from x", "dB", sines)}
"""By the name in the page: what is measured, its unit, and the trials."""
