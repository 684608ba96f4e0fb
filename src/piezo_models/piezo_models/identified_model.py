# SPDX-License-Identifier: BSD-3-Clause
"""A stage model together with the results of its identification."""

from dataclasses import dataclass, field
from datetime import UTC, datetime
from os import PathLike
from typing import TYPE_CHECKING, Any

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_models.cascade import StageModel
from piezo_models.model_summary import shortfall, summary_of_identified

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass
class IdentifiedModel:
    """A stage model with the results of its identification."""

    model: StageModel

    voltage_range_v: tuple[float, float]
    """Lowest and highest voltage of the identification in V."""
    sample_periods_s: dict[str, float] = field(default_factory=dict)
    """Sample period of each experiment, by its name."""
    errors: dict[str, Any] = field(default_factory=dict)
    """Errors on data that was not fitted; the names contain the units."""
    recordings: list[dict[str, str]] = field(default_factory=list)
    """Recordings that the model was identified from."""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """Time of creation, ISO 8601; now by default."""
    uncertainties: dict[str, Any] = field(default_factory=dict)
    """Standard deviations under "creep" and "dynamics", with the names and shapes of the model's
    parameters; under "effects" a list with one dict for each effect."""
    rows: dict[str, dict[str, float]] = field(default_factory=dict)
    """For each recording, the instant at which its rows are read and the remaining delay:
    `read_at_samples`, `delay_s` (missing if it cannot be determined), `standard_deviation_s`, and
    `is_straight` if the voltage is straight between the rows, not held."""
    visited: NDArray[np.bool_] | None = None
    """Cells of the density that the recordings determine, (L, L); lower triangular. The density in
    the other cells is extrapolated. None if this is not known."""
    adequacy: dict[str, dict[str, Any]] = field(default_factory=dict)
    """For each component (creep, dynamics, hysteresis) whether its residual exceeds the noise of
    the recording that it was estimated from; see `model_document.AdequacyPart`. Empty if this is
    not known."""
    unfinished: str = ""
    """Why the identification ended early, and what it did not try; empty if it was completed."""

    def __repr__(self) -> str:
        return f"<IdentifiedModel of {self.created}: {self.model!r}>"

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return parameters with standard deviations, coverage, errors and adequacy as a table."""
        return summary_of_identified(self)

    def shortfall(self) -> str:
        """Return what is unfinished or inadequate and the resulting error; empty if nothing is."""
        return shortfall(self.adequacy, self.errors, self.unfinished)

    def predict(self, voltage_v: ArrayLike, sample_period_s: float) -> FloatArray:
        """Return the predicted displacement under a voltage.

        Parameters
        ----------
        voltage_v : (N,) array_like
            Voltages in V, each held for a sample period. The stage has rested at the first one,
            reached from the lowest voltage.

        Returns
        -------
        (N,) array
            Displacement in um at the sample instants, each before its voltage acts.

        Raises
        ------
        ValueError
            If there is no voltage, one is not finite, or the sample period is not positive.
        """
        voltages_v = np.atleast_1d(np.asarray(voltage_v, dtype=float))
        if not voltages_v.size:
            raise ValueError("voltage_v is empty: give at least one voltage")
        return self.model.simulate(
            voltages_v, sample_period_s, self.model.memory(float(voltages_v[0])))

    def to_control(self, sample_period_s: float | None = None, lags: bool = True,
                   ) -> control.StateSpace:
        """Return the linear part as a system; see `piezo_models.control_objects.to_control`."""
        return self.model.to_control(sample_period_s, lags)

    def to_matlab(self, path: str | PathLike[str]) -> None:
        """Write the model for MATLAB; see `piezo_models.control_objects.write_matlab`."""
        self.model.to_matlab(path)

    def bode(self) -> "Figure":
        """Draw gain and phase of creep and dynamics with a 95 % band.

        The band follows from the standard deviations of the parameters, assumed independent. It
        does not include errors in the form of the model.
        """
        from piezo_models.model_pictures import bode_of

        return bode_of(self)

    def plot(self) -> "Figure":
        """Draw Preisach plane, loops and frequency response; see `model_pictures.draw_model`."""
        from piezo_models.model_pictures import draw_model

        return draw_model(self.model, self.visited)
