# SPDX-License-Identifier: BSD-3-Clause
"""Sizes of errors that are learned over kinds of motion."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.monitoring.usual_error import (
    BETWEEN,
    KINDS,
    WANDER,
    KnownError,
    UsualError,
    known_error,
)
from piezo_models.identified_model import IdentifiedModel

PART, NOISE_UM = 5e-3, 0.01


def motion(random):
    return np.exp(random.uniform(-3.0, 3.0, size=2))


def taught(kinds, between, blocks=5, seed=1):
    """A size of errors that has met kinds, each with a factor of its own."""
    random = np.random.default_rng(seed)
    usual = UsualError(KnownError(), 2, 100)
    for number in range(kinds):
        motion_um = motion(random)
        size = np.log(np.hypot(PART * np.linalg.norm(motion_um), NOISE_UM))
        size += between * random.normal()
        for _ in range(blocks):
            usual.take(motion_um, np.array([10.0 * number]), size + 0.02 * random.normal(), 1.0)
    return usual


def test_a_kind_that_was_never_met_is_expected_from_its_motion_as_widely_as_kinds_differ():
    for between in (0.2, 0.8):
        usual = taught(60, between)
        expected = usual.expected(np.array([3.0, 2.0]), np.array([-50.0]))
        truth = np.log(np.hypot(PART * np.hypot(3.0, 2.0), NOISE_UM))
        assert expected.middle == pytest.approx(truth, abs=0.6 * between + 0.1)
        assert 0.8 * np.hypot(between, WANDER) < expected.scale < 2.0 * np.hypot(between, WANDER)


def test_a_kind_that_was_met_is_expected_narrowly_at_its_own_size():
    usual = taught(20, 0.5, blocks=30)
    motion_um, features = np.array([3.0, 2.0]), np.array([-50.0])
    size = usual.expected(motion_um, features).middle + 0.8
    for _ in range(30):
        usual.take(motion_um, features, size, 1.0)
    expected = usual.expected(motion_um, features)
    assert expected.middle == pytest.approx(size, abs=0.02)
    assert expected.scale == pytest.approx(WANDER, rel=0.1)


def test_before_anything_is_met_what_is_stated_is_expected():
    usual = UsualError(KnownError(PART, NOISE_UM, 0.7), 2, 100)
    expected = usual.expected(np.array([3.0, 4.0]), np.zeros(1))
    assert np.exp(expected.middle) == pytest.approx(5.0 * PART, rel=0.1)
    assert BETWEEN < expected.scale < 1.0


def test_kinds_that_are_forgotten_bound_the_memory():
    assert len(taught(KINDS + 20, 0.3, blocks=1)._kinds) == KINDS


def test_a_model_file_states_its_error_and_noise(plant):
    part = {"residual_rms_um": 0.02, "noise_rms_um": 0.009, "ratio": 2.2, "verdict": "inadequate"}
    identified = IdentifiedModel(plant, (-20.0, 120.0), errors={"validation": {
        "e_y_percent": 0.3}}, adequacy={"creep": part, "dynamics": part | {"noise_rms_um": 0.01}})
    assert known_error(identified) == KnownError(0.003, 0.009, known_error(identified).spread)
    assert known_error(replace(identified, errors={}, adequacy={})) == KnownError()
