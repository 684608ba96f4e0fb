# SPDX-License-Identifier: BSD-3-Clause
"""Simulate a model for the voltage of a recording."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import outliers_of_residual
from piezo_identification.simulation.past_search import (
    after_saturation,
    conditioned,
    starting_past_v,
)
from piezo_identification.simulation.simulated_recording import PastVoltages
from piezo_models.cascade import StageModel
from piezo_models.effects.outliers import FEWEST
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Prediction:
    """Measured and simulated displacement of the part in which the waveform is played."""

    time_s: FloatArray
    voltage_v: FloatArray
    measured_um: FloatArray
    simulated_um: FloatArray
    """Samples after the start has settled, (N,)."""
    sample_index: NDArray[np.int64]
    """Numbers of the samples in the recording, (N,)."""
    past_v: PastVoltages = ()
    """Voltages before the recording from `starting_past_v`."""
    outlier: NDArray[np.bool_] | None = None
    """True for samples excluded from fits and errors, (N,); by default, none are."""
    reversed: bool = False
    """Whether the sign of the measured displacement was changed."""

    def __repr__(self) -> str:
        return (f"<Prediction: {self.time_s.size} samples, e_y = {self.e_y_percent():.3g} % of "
                "the measured displacement>")

    def plot(self) -> "Figure":
        """Draw measured and simulated displacement over time, and their difference."""
        from piezo_common.picture_style import (
            DIFFERENCE,
            MEASURED,
            MODELLED,
            WIDE_IN,
            label,
            new_figure,
        )

        figure = new_figure(5.0, WIDE_IN)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        above.plot(self.time_s, self.measured_um, **MEASURED)
        above.plot(self.time_s, self.simulated_um, **MODELLED)
        above.legend(loc="upper right")
        label(above, y="displacement (um)", title=f"e_y = {self.e_y_percent():.3g} %")
        below.plot(self.time_s, 1e3 * (self.measured_um - self.simulated_um), **DIFFERENCE)
        label(below, "time (s)", "difference (nm)")
        return figure

    @property
    def good(self) -> NDArray[np.bool_]:
        """Mask of the samples that are not outliers, shape (N,)."""
        return np.ones(self.time_s.size, dtype=bool) if self.outlier is None else ~self.outlier

    def e_y_percent(self, part: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Return the relative error (4.20) by the sensor, with the offset removed.

        `part` is a slice or mask of the samples to use, which are all by default.
        """
        used = np.zeros(self.time_s.size, dtype=bool)
        used[part] = True
        used &= self.good
        return e_y_percent(self.measured_um[used], self.simulated_um[used])


def predict(model: StageModel, recording: Recording) -> Prediction:
    """Simulate a model for the voltage of a recording.

    The initial state of the creep and the offset are fitted, as the motion before the recording is
    unknown. The past of the hysteresis is that of `starting_past_v`. The sign of the measured
    displacement is changed if it moves against the model. Outliers of the displacement and of the
    residual are excluded.

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short to settle.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> time_s = 0.01 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(3.0 * time_s)
    >>> stage, model = (StageModel(line, CreepDynamics(), ElectricVibrationDynamics(lag_s))
    ...                 for lag_s in (0.02, 0.0))
    >>> prediction = predict(model, recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 0.01)}))
    >>> print(f"{prediction.e_y_percent():.1f} %")
    7.8 %
    """
    recording, is_reversed = conditioned(model, recording)
    past_v = starting_past_v(model, recording)
    run = after_saturation(model, recording).after(past_v)
    part, settled = run.part, run.settled
    measured_um, voltage_v = run.measured_um[settled], run.voltage_v[settled]
    outlier, simulated_um = run.outlier[settled], run.fitted_um()
    standing_out = outliers_of_residual(
        measured_um - simulated_um, measured_um, voltage_v) & ~outlier
    if np.count_nonzero(standing_out) >= FEWEST:
        outlier = outlier | standing_out
        simulated_um = run.fitted_um(settled[~outlier])
    return Prediction(part.time_s[settled], voltage_v, measured_um, simulated_um,
                      part.sample_index[settled], past_v, outlier, is_reversed)
