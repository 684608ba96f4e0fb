# SPDX-License-Identifier: BSD-3-Clause
"""Models of a piezo-actuated stage: hysteresis, creep, dynamics, effects, and their files."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_models.axes.coupled import CoupledModel, Softening
    from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
    from piezo_models.axes_model_file import load_axes_model, save_axes_model
    from piezo_models.cascade import StageMemory, StageModel
    from piezo_models.control_objects import from_control, to_control
    from piezo_models.effects import EFFECTS, Effect, known_effects
    from piezo_models.hysteresis.first_rise import FirstRise
    from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
    from piezo_models.hysteresis.preisach import PreisachMemory, PreisachModel
    from piezo_models.identified_model import IdentifiedModel
    from piezo_models.linear.dynamics import (
        CreepDynamics,
        ElectricVibrationDynamics,
        simulate_linear,
        zoh,
    )
    from piezo_models.linear.periodic_inversion import invert_linear_periodic
    from piezo_models.measures import e_r_percent, e_rms_percent, e_y_percent
    from piezo_models.model_document import ModelFileError
    from piezo_models.model_file import load_model, save_model

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "CoupledModel", "Coupling", "CreepDynamics", "EFFECTS", "Effect", "ElectricVibrationDynamics",
    "FirstRise", "HystereticCreep", "IdentifiedAxes", "IdentifiedModel", "ModelFileError",
    "PreisachMemory", "PreisachModel", "Softening", "StageMemory", "StageModel", "e_r_percent",
    "e_rms_percent", "e_y_percent", "from_control", "invert_linear_periodic", "known_effects",
    "load_axes_model", "load_model", "save_axes_model", "save_model", "simulate_linear",
    "to_control", "zoh",
]
