# SPDX-License-Identifier: BSD-3-Clause
"""Connections by matrices: those of python-control, to the last digit."""

from functools import reduce

import control
import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.connections import (
    in_parallel,
    in_series,
    matrices_of,
    scaled,
    with_all_outputs,
)
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics, zoh


def systems():
    generator = np.random.default_rng(3)
    return [control.ss(*(generator.normal(size=shape) for shape in (
        (order, order), (order, 1), (1, order), (1, 1)))) for order in (1, 2, 0, 3)]


def assert_same(matrices, system):
    for own, other in zip(matrices, matrices_of(system), strict=True):
        np.testing.assert_array_equal(own, other)


def test_connections_are_those_of_python_control():
    given = systems()
    blocks = [matrices_of(system) for system in given]
    assert_same(in_series(blocks), reduce(lambda first, second: second * first, given))
    assert_same(in_parallel(blocks), reduce(lambda first, second: first + second, given))
    assert_same(scaled(0.3, blocks[1]), 0.3 * given[1])
    assert_same(with_all_outputs(blocks), reduce(control.append, given) * np.ones((4, 1)))


def test_nothing_in_series_passes_the_input_on():
    assert_same(in_series([]), control.ss([], [], [], [[1.0]]))


@pytest.mark.parametrize("pairs", [0, 1, 4])
def test_creep_is_its_sections_one_after_the_other(pairs):
    poles = tuple(10.0 ** np.arange(pairs))
    zeros = tuple(1.1 * pole for pole in poles)
    sections = [control.ss([[-p]], [[p]], [[z / p - 1.0]], [[1.0]])
                for p, z in zip(poles, zeros, strict=True)]
    whole = reduce(lambda first, second: second * first, sections,
                   control.ss([], [], [], [[1.0]]))
    assert_same(matrices_of(CreepDynamics(poles, zeros).state_space()), whole)


def test_modes_beside_each_other_share_the_displacement():
    dynamics = ElectricVibrationDynamics(1e-3, (400.0,), (0.05,))
    beside = VibrationMode(900.0, 0.02, 0.1)
    alone = ElectricVibrationDynamics(0.0, (400.0,), (0.05,)).state_space()
    lag = control.ss([[-1000.0]], [[1000.0]], [[1.0]], [[0.0]])
    assert_same(matrices_of(dynamics.state_space([beside])),
                (0.9 * alone + 0.1 * beside.state_space()) * lag)


def test_sampling_is_that_of_python_control():
    system = systems()[3] * systems()[1]
    assert_same(matrices_of(zoh(system, 0.01)), system.sample(0.01, "zoh"))


def test_the_linear_part_of_a_model_is_checked_a_few_times_alone(monkeypatch):
    checked, real = [], control.StateSpace.__init__

    def noted(*arguments, **options):
        checked.append(arguments)
        real(*arguments, **options)

    monkeypatch.setattr(control.StateSpace, "__init__", noted)
    poles = tuple(10.0 ** np.arange(9))
    StageModel(PreisachModel(0.0, 1.0, np.zeros((1, 1)), 0.0, np.ones(1)),
               CreepDynamics(poles, tuple(1.1 * pole for pole in poles)),
               ElectricVibrationDynamics(1e-3, (400.0,), (0.05,)),
               effects=(VibrationMode(911.0, 0.02, 0.1),)).linear()
    # Creep, dynamics, the mode beside them, which no other test has cached, and the whole.
    assert len(checked) == 4
