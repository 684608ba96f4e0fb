# SPDX-License-Identifier: BSD-3-Clause
"""Distortion from several realisations, against a filter and polynomials, which are known."""

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from piezo_identification.analysis.realisation_distortion import realisation_distortion
from piezo_identification.experiments.distortion_multisine import random_phase_multisine

LINES = np.arange(1, 200, 2)
SAMPLES, PERIOD_S = 2048, 1e-3


@pytest.fixture(scope="module")
def waves():
    random = np.random.default_rng(1)
    return np.array([random_phase_multisine(LINES, SAMPLES, random) for _ in range(8)])


def test_a_linear_stage_has_its_gain_and_no_distortion(waves):
    settled = lfilter([0.2], [1.0, -0.8], np.tile(waves, 3))[:, -SAMPLES:]
    found = realisation_distortion(waves, settled, PERIOD_S)
    _, expected = freqz([0.2], [1.0, -0.8], 2.0 * np.pi * LINES / SAMPLES)
    assert np.allclose(found.gain, expected, rtol=1e-9)
    assert np.allclose(found.frequency_hz, LINES / (SAMPLES * PERIOD_S))
    assert found.odd_percent < 1e-9 and found.even_percent < 1e-9


def test_a_square_is_even_and_a_cube_odd(waves):
    square = realisation_distortion(waves, waves + 0.1 * waves**2, PERIOD_S)
    cube = realisation_distortion(waves, waves + 0.1 * waves**3, PERIOD_S)
    assert square.odd_percent < 1e-9
    assert cube.even_percent < 1e-9
    # A Gaussian signal of variance v: the cube has 6 v^3 beside its best linear part 3 v x.
    variance = np.mean(waves**2)
    whole = np.sqrt(6.0 * (0.1) ** 2 * variance**3) / ((1.0 + 0.3 * variance) * np.sqrt(variance))
    assert 0.3 * whole < cube.odd_percent / 100.0 < 1.2 * whole


def test_too_few_realisations_and_even_lines_are_refused(waves):
    with pytest.raises(ValueError, match="2 realisations are given"):
        realisation_distortion(waves[:2], waves[:2], PERIOD_S)
    even = waves + waves**2
    with pytest.raises(ValueError, match="excites even lines"):
        realisation_distortion(even, even, PERIOD_S)
