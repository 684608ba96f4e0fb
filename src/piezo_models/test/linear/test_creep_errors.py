# SPDX-License-Identifier: BSD-3-Clause
"""Errors of a creep model leave it creep: it goes on in the direction of the step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_models.linear.creep_errors import creep_error_map, with_creep_errors
from piezo_models.linear.dynamics import CreepDynamics

CREEP = CreepDynamics((0.17, 2.0, 30.0), (0.18, 2.1, 33.0))


def test_the_map_is_the_derivative_of_rates_and_sizes():
    """Pole p (1 + a), size (z - p) (1 + a) (1 + b): derivatives by finite differences."""
    poles, zeros = np.array(CREEP.poles_rad_per_s), np.array(CREEP.zeros_rad_per_s)
    step = 1e-6
    columns = []
    for index in range(6):
        errors = step * np.eye(6)[index]
        moved = poles * (1 + errors[:3])
        sizes = (zeros - poles) * (1 + errors[:3]) * (1 + errors[3:])
        columns.append(np.log(np.r_[moved / poles, (moved + sizes) / zeros]) / step)
    np.testing.assert_allclose(creep_error_map(CREEP), np.transpose(columns), atol=1e-5)


@given(st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6))
def test_no_error_turns_creep_round(errors):
    changed = with_creep_errors(CREEP, np.array(errors))
    for pole, zero in zip(changed.poles_rad_per_s, changed.zeros_rad_per_s, strict=True):
        assert zero > pole * (1 - 1e-12)
    gain = np.prod(np.array(changed.zeros_rad_per_s) / changed.poles_rad_per_s)
    assert gain >= 1.0 - 1e-12


def test_no_creep_has_no_errors():
    assert creep_error_map(CreepDynamics()).shape == (0, 0)
    assert with_creep_errors(CreepDynamics(), np.empty(0)) == CreepDynamics()


def test_an_error_of_the_size_is_that_of_the_creep():
    pair = CreepDynamics((0.2,), (0.202,))
    more = with_creep_errors(pair, np.array([0.0, 0.1]))
    assert more.zeros_rad_per_s[0] - more.poles_rad_per_s[0] == pytest.approx(0.0022, rel=1e-2)
