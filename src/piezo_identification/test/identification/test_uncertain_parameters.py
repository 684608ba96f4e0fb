# SPDX-License-Identifier: BSD-3-Clause
"""What identify says of parameters that the recordings do not determine."""

import numpy as np
import pytest

from piezo_identification.identification.identify import report_uncertain_parameters
from piezo_identification.identification.linear_dynamics import FittedModel
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

POLES, ZEROS = (0.01, 0.1, 1.0), (0.0101, 0.101, 1.01)
WIDE, NARROW = (1.0, 1.0, 2.0), (1e-4, 1e-3, 1e-2)


@pytest.mark.parametrize(("poles", "zeros", "expected"), [
    (NARROW, NARROW, []),
    ((1e-4, 1e-3, 2.0), NARROW, ["do not determine creep poles_rad_per_s 3:"]),
    (WIDE, WIDE, ["the creep as a whole, not each of its 3 exponentials"]),
])
def test_creep_whose_exponentials_replace_one_another_is_told_as_a_whole(poles, zeros, expected):
    model = StageModel(PreisachModel.line(0.0, 10.0, 1.0), CreepDynamics(POLES, ZEROS),
                       ElectricVibrationDynamics())
    said = []
    report_uncertain_parameters(FittedModel(model, {
        "creep": {"poles_rad_per_s": poles, "zeros_rad_per_s": zeros}}, np.ones((1, 1), bool)),
        said.append)
    assert len(said) == len(expected)
    assert all(part in text for part, text in zip(expected, said, strict=True))
