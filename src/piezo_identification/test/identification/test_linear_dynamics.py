# SPDX-License-Identifier: BSD-3-Clause
"""What one recording tells of the creep is not lost where another tells nothing of it."""

from types import SimpleNamespace

from piezo_identification.estimators.estimate import Estimate
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


def test_response_without_creep_keeps_the_deviations_of_the_known_one():
    known = {"poles_rad_per_s": (0.1,), "zeros_rad_per_s": (0.2,)}
    found = LinearDynamics(CreepDynamics((1.0,), (1.1,)), uncertainties={"creep": known})
    response = SimpleNamespace(creep=CreepDynamics(), dynamics=ElectricVibrationDynamics(),
                               delay_s=0.0)
    deviations = {"creep": {"poles_rad_per_s": (), "zeros_rad_per_s": ()}, "dynamics": {},
                  "delay_s": 1.0}
    both = found.with_response(Estimate(response, deviations, 0, ()))
    assert both.creep == found.creep
    assert both.uncertainties["creep"] == known
