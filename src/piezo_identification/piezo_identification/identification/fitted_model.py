# SPDX-License-Identifier: BSD-3-Clause
"""A model assembled from the estimated components."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.first_rise import FirstRise


@dataclass(frozen=True)
class FittedModel:
    """A model with the standard deviations of its parameters, before its errors are measured."""

    model: StageModel

    uncertainties: dict[str, Any]
    """Standard deviations of creep and dynamics, as far as they were estimated."""
    visited: NDArray[np.bool_]
    """Cells of the Preisach plane that the data determine, (n, n)."""


def fitted_model(linear: LinearDynamics, density: DensityEstimate,
                 first_rise: FirstRise | None = None) -> FittedModel:
    """Assemble the estimated components; further parts of the dynamics become effects."""
    model = StageModel(
        density.model(), linear.creep, linear.dynamics, effects=linear.all_effects,
        first_rise=first_rise,
    )
    uncertainties: dict[str, Any] = dict(linear.uncertainties)
    if linear.all_effects:
        uncertainties["effects"] = list(linear.effect_deviations)
    return FittedModel(model, uncertainties, density.visited)
