# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.estimators.hysteresis.penalties import translation_operator
from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_models.hysteresis.preisach import PreisachModel

LEVELS_V = np.linspace(0.0, 150.0, 31)


def equally_wide_loops(size):
    """A density of alpha - beta alone."""
    width = np.subtract.outer(np.arange(size), np.arange(size))
    return np.tril(0.001 + 0.004 * np.exp(-width / (0.2 * size)))


def test_the_operator_finds_no_change_in_a_density_of_the_width_alone():
    density = equally_wide_loops(9)[np.tril_indices(9)]
    operator = translation_operator(9)
    assert operator.shape == (36, 45)
    np.testing.assert_allclose(operator @ density, 0.0, atol=1e-15)
    # One cell changed, (4, 2), shows in the differences to both its neighbours.
    density[12] += 1.0
    assert np.count_nonzero(np.abs(operator @ density) > 0.5) == 2


@pytest.mark.long
def test_major_loops_then_tell_of_nested_ones():
    truth = PreisachModel(0.0, 150.0, equally_wide_loops(150), 2.0)
    major_v = np.abs((np.arange(2400) + 600) % 1200 - 600) / 4.0
    slow_v, fast_v = 50.0 * np.cos(np.arange(2000) / 300.0), 25.0 * np.cos(np.arange(2000) / 15.0)
    nested_v = 75.0 - slow_v - fast_v
    output_um = truth.simulate(major_v)
    output_um += np.random.default_rng(1).normal(scale=0.005, size=output_um.size)

    def error_um(translation_weight):
        estimate = smoothed_density(
            major_v, output_um, LEVELS_V, translation_weight=translation_weight
        )
        return np.std(estimate.model().simulate(nested_v) - truth.simulate(nested_v))

    assert error_um(1e-8) < 0.3 * error_um(0.0)
