# SPDX-License-Identifier: BSD-3-Clause
"""How well axes follow a path, by the model in the time domain and by what is not known of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import Cell, SummaryTable
from piezo_controller.axes.coupled_inverse import INVERSES, invert_path, spectral_square
from piezo_controller.axes.repeated_period import repeated
from piezo_controller.axes.scan_path import ScanPath
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.linear.periodic_inversion import used_lines

SILENT = 1e-15
"""Ratio below which nothing but rounding couples: -300 dB."""


@dataclass(frozen=True, eq=False)
class PathPrediction:
    """What axes do while a path is repeated, after a gentle beginning from rest."""

    path: ScanPath

    displacement_um: dict[str, FloatArray]
    """In one period, by inverse: ``none``, ``diagonal``, ``coupled``."""
    error_percent: dict[str, FloatArray]
    """RMS error (2.32) without the offset, of an axis' travel; of the largest travel where an axis
    rests. Beside the inverses, ``uncertain`` is that of the coupled one to expect (RMS) with the
    deviations of the model; NaN where they are not known."""
    coupling_db: dict[str, FloatArray]
    """RMS motion of the axis of the row while the path moves that of the column alone, over the
    motion asked for, by the same names; NaN where the path does not move that axis."""

    @property
    def offset_um(self) -> dict[str, FloatArray]:
        """Return the mean of the displacement minus that of the path, in whole pm, by inverse."""
        position_um = self.path.position_um
        return {inverse: np.asarray(np.round(np.mean(each - position_um, axis=0), 6) + 0.0)
                for inverse, each in self.displacement_um.items()}

    def summary(self, title: str, notes: Sequence[str] = ()) -> SummaryTable:
        """Return errors and cross-coupling by inverse as a table."""
        axes = self.path.axes
        rows = [(f"{axis} error", "%", *_cells(self.error_percent, number))
                for number, axis in enumerate(axes)]
        unknown = {"uncertain": np.full(len(axes), np.nan)}
        rows += [(f"{axis} offset", "um", *_cells(self.offset_um | unknown, number))
                 for number, axis in enumerate(axes)]
        rows += [(f"{axes[moved]} from {axes[driven]}", "dB",
                  *_cells(self.coupling_db, moved, driven))
                 for driven, moved in np.argwhere(~np.eye(len(axes), dtype=bool))
                 if np.isfinite(self.coupling_db["none"][moved, driven])]
        return SummaryTable(
            title, ("", "unit", "no inverse", "diagonal inverse", "coupled inverse",
                    "with deviations"), rows,
            ("error: RMS over the travel (2.32), by the model in time, without noise and offset",
             "offset: what creep and the way into the path leave; it changes slowly",
             "from: motion of one axis while another alone follows its part of the path",
             "with deviations: to expect (RMS) of the coupled inverse with the uncertainty of the "
             "model's identification", *notes))


def _cells(values: dict[str, FloatArray], *at: int) -> tuple[Cell, ...]:
    return tuple(None if np.isnan(each[at]) else float(each[at]) for each in values.values())


def predict_path(path: ScanPath, model: CoupledModel, voltage_v: FloatArray, gain_limit: float,
                 identified: IdentifiedAxes | None = None) -> PathPrediction:
    """Simulate a path of all axes of the model by each inverse, and one axis of it at a time.

    The voltages are those of the coupled inverse. An identified model has the standard deviations.
    """
    travel_um = np.ptp(path.position_um, axis=0)
    moved = travel_um > 0.0
    travel_um = np.where(moved, travel_um, travel_um.max())
    n = len(path.axes)
    displaced, coupling, alone_v = {}, {}, {}
    for inverse in INVERSES:
        coupling[inverse] = np.full((n, n), np.nan)
        played_v = voltage_v if inverse == "coupled" else invert_path(
            path.position_um, model, inverse, gain_limit).voltage_v
        displaced[inverse] = repeated(played_v, model)
        for axis in np.flatnonzero(moved):
            alone_um = np.tile(path.centre_um, (len(path.position_um), 1))
            alone_um[:, axis] = path.position_um[:, axis]
            alone_v[axis] = invert_path(alone_um, model, inverse, gain_limit).voltage_v
            ratio = np.std(repeated(alone_v[axis], model), axis=0) / np.std(alone_um[:, axis])
            coupling[inverse][:, axis] = 20.0 * np.log10(np.maximum(ratio, SILENT))
    errors = {inverse: 100.0 * np.std(path.position_um - each, axis=0) / travel_um
              for inverse, each in displaced.items()}
    errors["uncertain"], coupling["uncertain"] = np.full(n, np.nan), np.full((n, n), np.nan)
    if identified is not None:
        errors["uncertain"] = np.hypot(
            errors["coupled"], 100.0 * _uncertain_um(voltage_v, identified) / travel_um)
        for axis, played_v in alone_v.items():  # of the coupled inverse, the last
            left = _uncertain_um(played_v, identified) / np.std(path.position_um[:, axis])
            ratio = np.hypot(left, 10.0 ** (coupling["coupled"][:, axis] / 20.0))
            coupling["uncertain"][:, axis] = 20.0 * np.log10(np.maximum(ratio, SILENT))
    return PathPrediction(path, displaced, errors, coupling)


def _uncertain_um(voltage_v: FloatArray, identified: IdentifiedAxes) -> FloatArray:
    """Return the RMS displacement of each axis that the deviations of the model leave open, (n,).

    The entries of the response are taken as independent of one another.
    """
    model, samples = identified.model, len(voltage_v)
    lines = np.fft.rfft(voltage_v - model.operating_voltage_v, axis=0)
    used = used_lines(lines)
    deviation = identified.response_deviation_um_per_v(used / (samples * model.sample_period_s))
    left = np.zeros((len(lines), len(model.axes)))
    left[used] = np.sqrt(np.einsum("fij,fj->fi", deviation**2, np.abs(lines[used]) ** 2))
    return np.sqrt(spectral_square(left, samples))
