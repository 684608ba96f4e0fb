# SPDX-License-Identifier: BSD-3-Clause
"""Effects that may extend the cascade: each is a module of this package and an entry of `EFFECTS`.

Other packages add effects through entry points of the group `piezo_models.effects`.
"""

from piezo_common.registered import registered
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.amplitude_damping import AmplitudeDamping
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.converter_steps import SensorSteps, VoltageSteps
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.creep import Creep
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import (
    Effect,
    Evidence,
    Extent,
    fitted_values,
    units_of_fitted,
    with_fitted_values,
)
from piezo_models.effects.gain_drift import GainDrift
from piezo_models.effects.hysteresis import Hysteresis
from piezo_models.effects.hysteretic_spring import HystereticSpring
from piezo_models.effects.outliers import Outliers
from piezo_models.effects.periodic_disturbance import PeriodicDisturbance
from piezo_models.effects.rate_dependent_hysteresis import RateDependentHysteresis
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.slew_limit import SlewLimit
from piezo_models.effects.stiffening import Stiffening
from piezo_models.effects.thermal_drift import ThermalDrift
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_models.effects.voltage_relaxation import VoltageRelaxation

EFFECTS = (
    Creep,
    ThermalDrift,
    GainDrift,
    VibrationMode,
    CoupledMode,
    Delay,
    SensorLag,
    SensorNonlinearity,
    PeriodicDisturbance,
    SlewLimit,
    VoltageClipping,
    Hysteresis,
    BoucWenHysteresis,
    CurvedBoucWenHysteresis,
    RateDependentHysteresis,
    AmplifierLag,
    SecondOrderAmplifier,
    VoltageRelaxation,
    BandLimitedVoltage,
    Stiffening,
    HystereticSpring,
    AmplitudeDamping,
    Backlash,
    VoltageSteps,
    SensorSteps,
    Outliers,
)
"""Effects of this package."""

GROUP = "piezo_models.effects"
"""Group of entry points through which other packages add effects."""

__all__ = [
    "EFFECTS", "GROUP", "Effect", "Evidence", "Extent", "fitted_values", "known_effects",
    "units_of_fitted", "with_fitted_values",
]


def known_effects() -> dict[str, type[Effect]]:
    """Return all effects by name, those of this package first.

    Raises
    ------
    ValueError
        If two have the same name, or one of another package cannot be imported.

    Examples
    --------
    >>> known_effects()["delay"](delay_s=1e-4)
    Delay(delay_s=0.0001)
    """
    return dict(registered(GROUP, {effect.name: effect for effect in EFFECTS}))
