# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of the stage: Preisach model, its inverse, and creep that depends on the branch."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_models.hysteresis.first_rise import FirstRise
    from piezo_models.hysteresis.hysteretic_creep import HystereticCreep, HystereticCreepMemory
    from piezo_models.hysteresis.preisach import PreisachMemory, PreisachModel

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "FirstRise", "HystereticCreep", "HystereticCreepMemory", "PreisachMemory", "PreisachModel",
]
