# SPDX-License-Identifier: BSD-3-Clause
"""The stage node over a backend: limits, watchdog, waveforms, feedback."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_stage_driver.backends.backend import BackendFault, StageBackend
    from piezo_stage_driver.backends.registry import BackendSettings, create_backend
    from piezo_stage_driver.engine.blocks import Block
    from piezo_stage_driver.engine.program import StageRefusal
    from piezo_stage_driver.engine.stage_engine import StageEngine
    from piezo_stage_driver.safety.commands import Command
    from piezo_stage_driver.safety.guards import StopLatch
    from piezo_stage_driver.safety.limits import FeedbackLimits, LimitError, VoltageLimits
    from piezo_stage_driver.safety.supervisor import StageSupervisor

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "BackendFault", "BackendSettings", "Block", "Command", "FeedbackLimits", "LimitError",
    "StageBackend", "StageEngine", "StageRefusal", "StageSupervisor", "StopLatch",
    "VoltageLimits", "create_backend",
]
