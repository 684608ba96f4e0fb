# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis from its own recordings, from other recordings, or from the gain of a response."""

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
"""Limit above the voltage of piezo amplifiers. The voltages of a response are unknown, so its line
is valid between minus and plus this voltage."""


@dataclass(frozen=True)
class DensityOptions:
    """Options for the density of the hysteresis; what is None is chosen from the data."""

    grid: int | None = None
    """Number of cells along each threshold."""
    smoothing_weight: float | None = None
    translation_weight: float | None = None
    """As in `piezo_identification.estimators.hysteresis.smoothed_density.density_of_segments`."""

    def __post_init__(self) -> None:
        if self.grid is not None and not 4 <= self.grid <= 300:
            raise ValueError(f"grid is {self.grid}: give 4 to 300")
        for name in ("smoothing_weight", "translation_weight"):
            weight = getattr(self, name)
            if weight is not None and not 0.0 <= weight < np.inf:
                raise ValueError(f"{name} is {weight:g}: give a number from 0 up")

    def keywords(self) -> dict[str, Any]:
        """Return the options as arguments of `density_fit.estimate_density`."""
        return {"level_count": self.grid, "cells_per_level": 2 if self.grid is None else 1,
                "smoothing_weight": self.smoothing_weight,
                "translation_weight": self.translation_weight or 0.0}


CHOSEN_BY_DATA = DensityOptions()


def estimate_hysteresis_of(
    recordings: Mapping[str, Data], linear: LinearDynamics,
    options: DensityOptions = CHOSEN_BY_DATA,
) -> DensityEstimate:
    """Estimate the hysteresis from its recordings, or from all others if there are none.

    Parameters
    ----------
    recordings : dict of str to Recording or FrequencyResponse
        Recordings without gaps.

    Returns
    -------
    DensityEstimate
        For a response alone, a line through 0 V with its gain.
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
