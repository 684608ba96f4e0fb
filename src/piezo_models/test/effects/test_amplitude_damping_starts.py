# SPDX-License-Identifier: BSD-3-Clause
"""Guesses of a damping that grows with speed, beside modes of any damping."""

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_models.effects.amplitude_damping import AmplitudeDamping
from piezo_models.effects.effect import Evidence
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S, W = 1e-3, 100.0


@pytest.mark.parametrize("damping_ratio", [0.02, 0.6, 1.5])
def test_a_guess_is_possible_whatever_the_damping_of_the_mode(damping_ratio):
    displacement_um = lfilter([0.1], [1.0, -0.9], np.random.default_rng(1).normal(size=4000))

    def reduction(contributions, positive=False):
        # Far less linear damping than the model has, and some that grows with speed.
        gains = np.array([-9.0, 3.0])[: contributions.shape[1]]
        return gains, 0.9 if contributions.shape[1] == 2 else 0.1

    evidence = Evidence(
        PERIOD_S, displacement_um, displacement_um, np.zeros(4000), 1e-3,
        ElectricVibrationDynamics(0.0, (W,), (damping_ratio,)), displacement_um, reduction,
        lambda contribution: 1.0)
    guess, = AmplitudeDamping.starts(evidence)
    assert guess.viscous == pytest.approx(max(-2.0 * damping_ratio, -1.0))
    assert guess.quadratic == 3.0
