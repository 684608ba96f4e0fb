# SPDX-License-Identifier: BSD-3-Clause
"""A simulated piezo-actuated stage behind the stage node."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_sim.plant.plant import Plant
    from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
    from piezo_sim.plant.plant_file import read_plant
    from piezo_sim.simulated_stage import SimulatedStage

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = ["Plant", "PlantConfigError", "SimulatedStage", "Surroundings", "read_plant"]
