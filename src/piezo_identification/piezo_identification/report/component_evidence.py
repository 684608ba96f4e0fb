# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of the components of an identified model on their recordings, for the report."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.adequacy.component_adequacy import COMPONENTS
from piezo_identification.adequacy.component_residual import ComponentResidual, component_residual
from piezo_identification.adequacy.lack_of_fit import LackOfFit, lack_of_fit
from piezo_identification.conditioning.row_alignment import read_as
from piezo_identification.conditioning.segments import experiment_of, testable
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.identification.given_data import (
    Data,
    conditioned_data,
    with_straight_voltages,
)
from piezo_identification.identification.recorded_hum import hum_of_each, without_hum
from piezo_identification.identification.row_delays import delays_of_rows_s
from piezo_identification.report.waveform_view import WaveformView, view_of
from piezo_models.identified_model import IdentifiedModel


@dataclass(frozen=True, eq=False)
class ComponentEvidence:
    """A recording with the fit of the component that was estimated from it."""

    name: str
    """Name of the recording: creep, dynamics or hysteresis, numbered if there are several."""
    residual: ComponentResidual
    fit: LackOfFit
    hum: str = ""
    """Sentence on the hum that was subtracted; empty if there was none."""

    @property
    def component(self) -> str:
        """Creep, dynamics or hysteresis."""
        return experiment_of(self.name)

    @property
    def is_response(self) -> bool:
        """Whether it is a frequency response, without time."""
        return self.residual.frequency_hz is not None

    @cached_property
    def view(self) -> WaveformView:
        """The samples to draw."""
        return view_of(self.residual.voltage_v, self.residual.sample_period_s)

    @property
    def fitted_um(self) -> FloatArray:
        """Displacement of the fitted model, shape (N,)."""
        return self.residual.measured_um - self.residual.residual_um

    @property
    def residual_um(self) -> FloatArray:
        """Residual of the model, 0 at excluded samples, shape (N,)."""
        return np.where(self.residual.good, self.residual.residual_um, 0.0)

    @property
    def noise_um(self) -> float:
        """Standard deviation of the noise of a single sample."""
        period = self.residual.period
        repeats = self.residual.measured_um.size // period if period else 1
        return self.fit.noise_rms_um * float(np.sqrt(max(repeats, 1)))


def component_evidence(identified: IdentifiedModel, given: Mapping[str, Data],
                       read_at_samples: float = 0.0) -> list[ComponentEvidence]:
    """Return the residuals of creep, dynamics and hysteresis, as the identification tested them.

    `read_at_samples` is that of the call of `identify`.
    """
    conditioned = with_straight_voltages(
        conditioned_data(given, lambda text: None, read_at_samples),
        [name for name, row in identified.rows.items() if row.get("is_straight")])
    read_at = {name: identified.rows[name]["read_at_samples"] - read_as(data, read_at_samples)
               for name, data in conditioned.items()
               if name in identified.rows and not isinstance(data, FrequencyResponse)}
    delays_s = delays_of_rows_s(conditioned, read_at)
    humming = hum_of_each(conditioned, identified.model, delays_s)
    conditioned = without_hum(conditioned, humming)
    found = []
    for component in COMPONENTS:
        for name, data in testable(conditioned).items():
            if experiment_of(name) == component:
                residual = component_residual(
                    component, identified.model, data, delays_s.get(name, 0.0))
                hum = humming[name].sentence if name in humming else ""
                found.append(ComponentEvidence(name, residual, lack_of_fit(residual), hum))
    return found
