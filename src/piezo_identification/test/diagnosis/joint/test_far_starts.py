# SPDX-License-Identifier: BSD-3-Clause
"""A play that the hysteresis has made up for is found, whatever its width."""

import numpy as np
import pytest
from made_by_scipy import behind_mode, behind_play, logged, smooth_noise_v

from piezo_identification.diagnosis.joint.alternatives import from_afar
from piezo_identification.fitting.joint_fit import JointProblem
from piezo_identification.fitting.model_weights import held_out_of
from piezo_models.cascade import StageModel
from piezo_models.effects.backlash import Backlash
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

SAMPLES, NOISE_UM = 3000, 2e-3
MODE_RAD_PER_S, DAMPING_RATIO, GAIN = 400.0, 0.1, 0.1
CELLS = 50


def recording(seed, width_um):
    """Record a line with a mode and a play behind it, which is written as a loop."""
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, 60)
    driving_um = behind_mode(GAIN * voltage_v, MODE_RAD_PER_S, DAMPING_RATIO)
    trailing_um = behind_play(driving_um, width_um)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, trailing_um + noise_um, name=f"{seed}")


def bent(width_um):
    """Return a model whose hysteresis has made up for the play, and whose mode is off."""
    levels_v = np.linspace(-100.0, 100.0, CELLS + 1)
    motion_um = np.maximum(GAIN * np.subtract.outer(levels_v, levels_v) - width_um, 0.0)
    cells = motion_um[1:, :-1] - motion_um[:-1, :-1] - motion_um[1:, 1:] + motion_um[:-1, 1:]
    cell_v = levels_v[1] - levels_v[0]
    return StageModel(
        PreisachModel(-100.0, 100.0, np.tril(cells, -1) / cell_v**2, -10.0,
                      np.diagonal(motion_um, -1) / cell_v), CreepDynamics(),
        ElectricVibrationDynamics(0.0, (360.0,), (0.15,)))


@pytest.mark.parametrize("width_um", [
    pytest.param(0.4, marks=pytest.mark.long), pytest.param(0.8, marks=pytest.mark.long), 1.6])
def test_a_play_is_taken_out_of_the_hysteresis_that_has_it(width_um):
    problem = JointProblem(bent(width_um), [recording(1, width_um)], [recording(2, width_um)])
    simpler = problem.fit(())
    guesses = [Backlash(width) for width in np.geomspace(0.01, 3.0, 5)]
    nearby = problem.fit(guesses[:1], begun=simpler)
    found = from_afar(problem, simpler, guesses, nearby)
    assert found.against < nearby.against - 100.0
    assert found.effects[0].width_um == pytest.approx(width_um, rel=0.05)
    dynamics = found.model.dynamics
    assert dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(MODE_RAD_PER_S, rel=0.01)
    assert dynamics.damping_ratios[0] == pytest.approx(DAMPING_RATIO, rel=0.1)
    assert np.sqrt(held_out_of(found)[0].mean_square_um2) < 0.02 * width_um
