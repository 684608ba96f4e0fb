# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of two models on one recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.summary_table import Cell, SummaryTable
from piezo_identification.prediction.prediction import Prediction
from piezo_offline.steps import AnyModel, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("a", "b")


@dataclass(frozen=True, repr=False)
class Comparison:
    """Predictions of two models for one recording."""

    a: Prediction
    b: Prediction

    def __repr__(self) -> str:
        return repr(self.summary())

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return the errors of both models as a table, in percent and in um."""
        rows: list[tuple[Cell, ...]] = []
        for name in NAMES:
            prediction: Prediction = getattr(self, name)
            residual_um = (prediction.measured_um - prediction.simulated_um)[prediction.good]
            rows.append((f"model {name}", prediction.e_y_percent(), float(np.std(residual_um)),
                         float(np.abs(residual_um - residual_um.mean()).max())))
        return SummaryTable("errors of two models on one recording, without their means",
                            ("", "e_y (%)", "rms (um)", "largest (um)"), rows)

    def plot(self) -> "Figure":
        """Draw the residuals of both models over time."""
        from piezo_common.picture_style import CURVES, WIDE_IN, label, new_figure

        figure = new_figure(3.6, WIDE_IN)
        axes = figure.subplots()
        for name, style in zip(NAMES, CURVES, strict=False):
            prediction: Prediction = getattr(self, name)
            residual_um = prediction.measured_um - prediction.simulated_um
            axes.plot(prediction.time_s, 1e3 * residual_um, **style, label=f"model {name}")
        label(axes, "time (s)", "measured minus simulated (nm)")
        axes.legend()
        return figure


def compare(model_a: AnyModel, model_b: AnyModel, data: Any, *,
            columns: Sequence[str] = ()) -> Comparison:
    """Run two models on the voltage of one recording, and compare their residuals.

    Parameters
    ----------
    model_a, model_b : IdentifiedModel, StageModel or path-like
    data : path, arrays by name, pandas.DataFrame or Recording
        Recording that neither model was fitted to; otherwise the closer fit would win.
    columns : sequence of str
        As for `piezo_offline.read`.

    Raises
    ------
    ValueError
        If the recording cannot be read or is too short, or has several axes.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> stiff, soft = (StageModel(line, CreepDynamics(), ElectricVibrationDynamics(lag_s))
    ...                for lag_s in (0.0, 5e-3))
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> compared = compare(stiff, soft, {
    ...     "time_s": time_s, "voltage_v": voltage_v, "displacement_um": 2.0 * voltage_v})
    >>> print([round(each.e_y_percent(), 1) for each in (compared.a, compared.b)])
    [0.0, 11.0]
    """
    a, b = (simulate(model, data, columns=columns) for model in (model_a, model_b))
    if not (isinstance(a, Prediction) and isinstance(b, Prediction)):
        raise ValueError("compare takes models of one axis: simulate those of several one by one")
    return Comparison(a, b)
