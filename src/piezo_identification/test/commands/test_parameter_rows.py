# SPDX-License-Identifier: BSD-3-Clause
"""Parameters are printed with their standard deviations, frequencies in Hz beside rad/s."""

import numpy as np
import pytest

from piezo_identification.commands.parameter_rows import parameter_rows, with_deviation
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@pytest.mark.parametrize(("value", "deviation", "text"), [
    (8795.31234, 1.13, "8795.3 +- 1.1"), (0.0097312, 0.00012, "0.00973 +- 0.00012"),
    (1234.5678, None, "1234.6"), (1234.5678, 0.0, "1234.6"), (2.0, np.nan, "2"),
    (12345.6, 250.0, "12346 +- 2.5e+02"), (1e-9, 3e-11, "1e-09 +- 3e-11")])
def test_value_has_as_many_digits_as_its_deviation_leaves(value, deviation, text):
    assert with_deviation(value, deviation) == text


def test_frequencies_stand_in_hertz_beside_their_angular_ones():
    model = StageModel(
        PreisachModel(0.0, 10.0, np.tril(np.ones((4, 4)))),
        CreepDynamics([0.1], [0.2]),
        ElectricVibrationDynamics(1e-4, [2000.0 * np.pi], [0.01], []))
    identified = IdentifiedModel(model, (0.0, 10.0), uncertainties={
        "dynamics": {"mode_frequencies_rad_per_s": [2.0 * np.pi], "time_constant_s": 2e-6}})
    rows = parameter_rows(identified)
    assert ("", "1000.0 +- 1.0 Hz") in rows
    assert ("mode frequencies", "6283.2 +- 6.3 rad/s") in rows
    assert ("electric time constant", "0.1000 +- 0.0020 ms") in rows
    assert ("creep poles", "0.1 rad/s") in rows
