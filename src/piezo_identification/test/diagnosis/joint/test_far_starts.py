# SPDX-License-Identifier: BSD-3-Clause
"""A play that the hysteresis has made up for is found, whatever its width."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_identification.diagnosis.joint.alternatives import from_afar
from piezo_identification.fitting.joint_fit import JointProblem
from piezo_models.cascade import StageModel
from piezo_models.effects.backlash import Backlash
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, SAMPLES, NOISE_UM = 1e-3, 3000, 2e-3
MODE_RAD_PER_S, DAMPING_RATIO, GAIN = 400.0, 0.1, 0.1
CELLS = 50


def recording(seed, width_um):
    """Record a line with a mode and a play behind it, which is written as a loop."""
    generator = np.random.default_rng(seed)
    voltage_v = np.convolve(generator.normal(size=SAMPLES), np.hanning(60), mode="same")
    voltage_v *= 50.0 / np.abs(voltage_v).max()
    w, z = MODE_RAD_PER_S, DAMPING_RATIO
    numerator, denominator, _ = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), PERIOD_S, "zoh")
    trailing_um, last = np.empty(SAMPLES), 0.0
    for n, position in enumerate(lfilter(numerator[0], denominator, GAIN * voltage_v)):
        last = min(max(last, position - 0.5 * width_um), position + 0.5 * width_um)
        trailing_um[n] = last
    return Recording(
        path=f"{seed}", sample_rate_hz=1.0 / PERIOD_S, sample_index=np.arange(SAMPLES),
        sample_periods_s=np.full(SAMPLES, PERIOD_S), voltage_v=voltage_v,
        displacement_um=trailing_um + NOISE_UM * generator.normal(size=SAMPLES),
        flags=np.full(SAMPLES, Flag.PLAYING, dtype=np.uint32))


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
    residual_um, held_out = found.residual_um()[0]
    assert np.sqrt(np.mean(residual_um[held_out] ** 2)) < 0.02 * width_um
