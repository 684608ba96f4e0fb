# SPDX-License-Identifier: BSD-3-Clause
"""Linear dynamics of the stage: creep, electric lag and modes of vibration, and their inverse."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_models.linear.dynamics import (
        CreepDynamics,
        ElectricVibrationDynamics,
        continue_linear,
        equilibrium_state,
        simulate_linear,
        zoh,
        zoh_response,
    )
    from piezo_models.linear.periodic_inversion import invert_linear_periodic

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "CreepDynamics", "ElectricVibrationDynamics", "continue_linear", "equilibrium_state",
    "invert_linear_periodic", "simulate_linear", "zoh", "zoh_response",
]
