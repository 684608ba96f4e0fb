# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis of whatever is given: its own recordings, the others, or a response's gain."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_identification.estimators.hysteresis.density_estimate import (
    LINE_OF_RESPONSE,
    DensityEstimate,
)
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.identification.given_data import Data, of_kind
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_recorder.reading.recording import Recording

ANY_VOLTAGE_V = 1000.0
"""Beyond what piezo amplifiers give: a response does not tell where it was measured, so its line
holds up to here on either side of 0 V."""


@dataclass(frozen=True)
class DensityOptions:
    """What may be asked of the density of the hysteresis.

    Parameters
    ----------
    grid : int, optional
        Cells along each threshold.
    smoothing_weight, translation_weight : float, optional
        Of `piezo_identification.estimators.hysteresis.smoothed_density.smoothed_density`.
    """

    grid: int | None = None
    smoothing_weight: float | None = None
    translation_weight: float | None = None

    def keywords(self) -> dict[str, Any]:
        """Return them as arguments of `density_fit.estimate_density`."""
        return {"level_count": self.grid, "cells_per_level": 2 if self.grid is None else 1,
                "smoothing_weight": self.smoothing_weight,
                "translation_weight": self.translation_weight}


CHOSEN_BY_DATA = DensityOptions()


def estimate_hysteresis_of(
    recordings: Mapping[str, Data], linear: LinearDynamics,
    options: DensityOptions = CHOSEN_BY_DATA,
) -> DensityEstimate:
    """Estimate the hysteresis from its recordings, or else from all others.

    Parameters
    ----------
    recordings : dict of str to Recording or FrequencyResponse
        Without gaps.
    linear : LinearDynamics
        Creep and dynamics, which are removed.

    Returns
    -------
    DensityEstimate
        Of a response alone, a line through 0 V with its gain.
    """
    shown = of_kind(recordings, "hysteresis") or [
        data for name in ("creep", "dynamics") for data in of_kind(recordings, name)
        if isinstance(data, Recording)]
    if not shown:
        return _line_of_response(linear)
    return estimate_density(
        shown, linear.creep, linear.slow_dynamics, delay_s=linear.slow_delay_s,
        **options.keywords())


def _line_of_response(linear: LinearDynamics) -> DensityEstimate:
    # Of a sensor that counts the other way, the model's displacement rises with the voltage.
    gain = abs(float(linear.estimates["dynamics"].model.gain))
    return DensityEstimate(
        LINE_OF_RESPONSE, np.array([-ANY_VOLTAGE_V, ANY_VOLTAGE_V]), np.zeros((1, 1)),
        -gain * ANY_VOLTAGE_V, np.ones((1, 1), dtype=bool),
        reversible_um_per_v=np.array([gain]))
