# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage of a demo."""

from dataclasses import dataclass
from pathlib import Path

from piezo_sim.plant.named_plants import PLANTS
from piezo_sim.plant.plant_file import read_plant
from piezo_studies.demo.demo_command import USUAL

SENTENCES = {
    "default": "The stage has the form of the model: a Preisach hysteresis, creep by poles and "
    "zeros, an electric lag and two modes.",
    "undeclared": "The stage does more than the model of the thesis describes: it has a third mode "
    "and a creep with the logarithm of time.",
    "beam": "The stage shares no mathematical form with the model: its hysteresis is made of "
    "rate-dependent plays and has loops that no Preisach density has, it creeps by a power of "
    "time, its electric lag is spread along a line behind an amplifier that slews, and it vibrates "
    "as a beam of three coupled modes. Its converters jitter, its frame drifts with the "
    "temperature, and its sensor has a bandwidth of 5 kHz.",
}


@dataclass(frozen=True)
class DemoPlant:
    """The plant of a demo."""

    plant: str
    """Parameter of the stage node: a name, or the absolute path of a plant file."""
    name: str
    """Name for users and for the directory of the results."""
    sentence: str
    """Description of the stage for the report."""

    @property
    def directory(self) -> Path:
        """Default directory of the results."""
        return Path("runs", "demo" if self.name == USUAL else f"demo-{self.name}")


def demo_plant(plant: str = USUAL) -> DemoPlant:
    """Describe the plant of a demo: one of the simulator, by its name, or a plant file.

    PlantConfigError is raised if there is no such plant, or its file cannot be used.
    """
    read_plant(plant)
    if plant in PLANTS:
        return DemoPlant(plant, plant, SENTENCES[plant])
    path = Path(plant).absolute()
    return DemoPlant(str(path), path.stem, f"The stage is that of the plant file {path.name}.")
