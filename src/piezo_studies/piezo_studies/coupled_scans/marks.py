# SPDX-License-Identifier: BSD-3-Clause
"""How late pixels are marked on the simulated XY stage, by time and by measured position."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_client.scan_marks import marked
from piezo_client.scans import Scanned
from piezo_common.arrays import FloatArray
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import StoredScan, stored_scan
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.sample_block import Mark
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.coupled_scans.xy_stage import PLANT, VOLTAGE_RANGE_V, moving, plant_of_study
from piezo_studies.tables import markdown_table

SIZE_UM, LINES = 20.0, 16
LINES_PER_S = (5.0, 20.0, 100.0)


@dataclass(frozen=True)
class MarkRow:
    """One raster: how far each pixel is marked from its place."""

    path: str
    sample_nm: float
    """Motion of the fast axis in a sample, at the pixels."""

    by_time: FloatArray
    by_position: FloatArray
    """Samples by which the mark is too late, for each pixel of a frame."""


def rasters_marked(model: IdentifiedAxes) -> Iterator[MarkRow]:
    """Mark rasters in both directions by time, then by the positions of an earlier run."""
    for lines_per_s in LINES_PER_S:
        plan = scan(model, "raster", size_um=(SIZE_UM, SIZE_UM), lines=LINES, rate_hz=lines_per_s,
                    both_directions=True, voltage_range_v=VOLTAGE_RANGE_V)
        planned = stored_scan(plan)
        places_um = plan.path.position_um[plan.path.marks & Mark.PIXEL > 0, 0]
        measured_um, _ = _played(planned, 21)
        by_position = marked(Scanned(Path(PLANT), planned, measured_um))
        seen_um = _seen_um(*_played(planned, 22))
        velocity_um = np.gradient(seen_um)
        at = [np.flatnonzero(each.marks & Mark.PIXEL) for each in (planned, by_position)]
        late = [(seen_um[each] - places_um) / velocity_um[each] for each in at]
        yield MarkRow(f"{lines_per_s:.0f} lines/s",
                      1e3 * float(np.abs(velocity_um[at[0]]).mean()), *late)


def _played(planned: StoredScan, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return readings and true positions in the second period."""
    stage = moving(planned, 1, SimulatedStage(plant_of_study(), seed))
    return stage.exchange(planned.voltage_v), stage.true_displacement_um


def _seen_um(reading_um: FloatArray, true_um: FloatArray) -> FloatArray:
    """Return what the first sensor would read if it were neither late nor noisy, (N,).

    Sensors are out of square: readings are fitted by true positions, and by speeds because of the
    delay.
    """
    terms = np.column_stack([true_um, np.ones(len(true_um)), np.gradient(true_um, axis=0)])
    parts = np.linalg.lstsq(terms, reading_um[:, 0], rcond=None)[0]
    seen_um: FloatArray = terms[:, :3] @ parts[:3]
    return seen_um


def mark_table(rows: Iterator[MarkRow]) -> str:
    """Return the rows as Markdown."""
    return markdown_table(
        ("raster of 20 um, both directions", "a sample, nm", "by time: RMS, samples", "largest",
         "by position: RMS, samples", "largest"),
        [(row.path, *(f"{number:.2g}" for number in (row.sample_nm, *(
            number for late in (row.by_time, row.by_position)
            for number in (np.sqrt(np.mean(late**2)), np.abs(late).max()))))) for row in rows])
