# SPDX-License-Identifier: BSD-3-Clause
"""A simulated piezo-actuated stage behind the stage node."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_sim.plant.plant import Plant
    from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
    from piezo_sim.plant.plant_file import read_plant
    from piezo_sim.simulated_stage import SimulatedStage

_HOMES = {
    "Plant": "plant.plant",
    "PlantConfigError": "plant.plant_effect",
    "Surroundings": "plant.plant_effect",
    "read_plant": "plant.plant_file",
    "SimulatedStage": "simulated_stage",
}
__getattr__, __dir__ = lazy_exports(__name__, _HOMES)

__all__ = [
    "Plant", "PlantConfigError", "SimulatedStage", "Surroundings", "read_plant",
]
