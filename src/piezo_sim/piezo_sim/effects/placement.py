# SPDX-License-Identifier: BSD-3-Clause
"""The place of an undeclared effect, which models do not contain, in the chain of a plant."""

import dataclasses
from collections.abc import Sequence

from piezo_sim.effects.ambient_temperature import ThermalDrift
from piezo_sim.effects.current_limit import CurrentLimit
from piezo_sim.effects.depolarisation import Depolarisation
from piezo_sim.effects.guide_spring import GuideSpring
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.effects.intermittent_contact import IntermittentContact
from piezo_sim.effects.loaded_mode import LoadedMode
from piezo_sim.effects.logarithmic_creep import LogarithmicCreep
from piezo_sim.effects.parallel_mode import ParallelMode
from piezo_sim.effects.self_heating import SelfHeating
from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_sim.effects.soft_saturation import SoftSaturation
from piezo_sim.effects.switched_heat import SwitchedHeat
from piezo_sim.effects.switching_delay import SwitchingDelay
from piezo_sim.plant.continuous_preisach import PreisachHysteresis
from piezo_sim.plant.linear_effects import VibrationMode
from piezo_sim.plant.plant_effect import Effect
from piezo_sim.plant.plant_file import PlantConfig
from piezo_sim.plant.sensor import DisplacementSensor


def add_effect(plant: PlantConfig, effect: Effect) -> PlantConfig:
    """Return a plant with an undeclared effect at its place in the chain.

    A `LoadedMode` replaces the mode of the nearest frequency; a `GuideSpring` is placed behind it.
    The plant has at least the effects of the default plant.
    """
    stage = list(plant.stage)
    linear = [i for i, other in enumerate(stage) if hasattr(other, "state_space")]
    if isinstance(effect, CurrentLimit | SoftSaturation):
        return dataclasses.replace(plant, amplifier=(*plant.amplifier, effect))
    if isinstance(effect, SwitchingDelay):
        stage.insert(0, effect)
    elif isinstance(effect, HardeningSpring | SelfHeating | IntermittentContact | Depolarisation):
        hysteresis = [isinstance(other, PreisachHysteresis) for other in stage].index(True)
        stage.insert(hysteresis + 1, effect)
    elif isinstance(effect, LogarithmicCreep):
        stage.insert(linear[0], effect)
    elif isinstance(effect, ParallelMode):
        modes = [i for i in linear if isinstance(stage[i], VibrationMode)]
        stage.insert(modes[-1] + 1, effect)
    elif isinstance(effect, LoadedMode):
        stage[_nearest_mode(stage, effect.frequency_rad_per_s)] = effect
    elif isinstance(effect, GuideSpring):
        stage.insert(_nearest_mode(stage, effect.frequency_rad_per_s) + 1, effect)
    elif isinstance(effect, SoftBacklash | SwitchedHeat | ThermalDrift):
        stage.append(effect)
    else:
        sensor = list(plant.sensor)
        converter = [isinstance(other, DisplacementSensor) for other in sensor].index(True)
        sensor.insert(converter, effect)
        return dataclasses.replace(plant, sensor=tuple(sensor))
    return dataclasses.replace(plant, stage=tuple(stage))


def _nearest_mode(stage: Sequence[Effect], frequency_rad_per_s: float) -> int:
    """Return the index of the mode of the nearest frequency."""
    frequencies = {mode.frequency_rad_per_s: place for place, mode in enumerate(stage)
                   if isinstance(mode, VibrationMode)}
    return frequencies[min(frequencies, key=lambda w: abs(w - frequency_rad_per_s))]
