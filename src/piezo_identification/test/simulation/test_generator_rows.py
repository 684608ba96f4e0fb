# SPDX-License-Identifier: BSD-3-Clause
"""Square waves of generators that change their level between the rows of a recording."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.generator_edges import EARLY_EDGE
from piezo_identification.fitting.whole_model import WholeModel
from piezo_identification.simulation.generator_rows import with_generator_edges
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

PERIOD_S, FINER, COUNT = 1e-4, 50, 3000
EDGES = 16564 + 14368 * np.arange(9)
"""Changes of the level, in fine steps; the levels last equally long."""
NOISE_UM = 2e-3


def model(*effects):
    hysteresis = PreisachModel(0.0, 60.0, np.tril(np.full((12, 12), 2e-3)), 0.0,
                               np.full(12, 0.1))
    return StageModel(hysteresis, CreepDynamics(), ElectricVibrationDynamics(
        1e-4, (2.0 * np.pi * 700.0,), (0.02,)), effects=effects)


def voltage_v(finer):
    """Return the voltage at each part of the rows."""
    step = np.arange(COUNT * finer) * (FINER // finer)
    return 50.0 - 40.0 * (np.searchsorted(EDGES, step, side="right") % 2)


def recorded(stage, noise_um=0.0):
    """Return rows of a stage, simulated in fine steps, and the times by which edges are early."""
    fine_s = PERIOD_S / FINER
    moved_um = SimulatedRecording(stage, recording_of({
        "time_s": fine_s * np.arange(COUNT * FINER), "voltage_v": voltage_v(FINER),
        "displacement_um": np.zeros(COUNT * FINER)})).simulate()[::FINER]
    moved_um = moved_um + np.random.default_rng(3).normal(scale=noise_um, size=COUNT)
    early = np.zeros(COUNT)
    shown = -(-EDGES // FINER)
    early[shown] = shown - EDGES / FINER
    return recording_of({"time_s": PERIOD_S * np.arange(COUNT), "voltage_v": voltage_v(1),
                         "displacement_um": moved_um}), early


@pytest.mark.parametrize("effects, accuracy", [
    ((), 2e-4), ((Delay(4e-5),), 2e-4), ((AmplifierLag(2e-4),), 1e-3)])
def test_rows_between_which_the_level_changes_are_those_of_a_fine_simulation(effects, accuracy):
    stage = model(*effects)
    recording, early = recorded(stage)
    moved = replace(recording, columns={EARLY_EDGE: early})
    swing_um = np.ptp(recording.displacement_um)
    error_um = SimulatedRecording(stage, moved).simulate() - recording.displacement_um
    assert np.abs(error_um).max() < accuracy * swing_um
    at_rows_um = SimulatedRecording(stage, recording).simulate() - recording.displacement_um
    assert np.abs(at_rows_um).max() > 0.1 * swing_um


def test_edges_are_fitted_until_the_noise_remains():
    stage = model()
    recording, early = recorded(stage, NOISE_UM)
    first, second = with_generator_edges(stage, [recording, recording], [0.0, 0.0])
    assert SimulatedRecording(stage, second).error_um() == pytest.approx(NOISE_UM, rel=0.05)
    np.testing.assert_allclose(second.columns[EARLY_EDGE], early, atol=1e-3)
    # The mean time of the edges of the first one is that of the samples, as a delay may explain it.
    off = (first.columns[EARLY_EDGE] - early)[early > 0.0]
    np.testing.assert_allclose(off, off.mean(), atol=2e-3)


def test_a_recording_whose_edges_lie_at_its_rows_is_unchanged():
    recording, _ = recorded(model(), NOISE_UM)
    regular_v = 10.0 + 40.0 * (np.arange(COUNT) // 300 % 2)
    regular = replace(recording, voltage_v=regular_v)
    assert with_generator_edges(model(), [regular], [0.0]) == [regular]


def test_a_whole_model_is_fitted_to_the_rows_of_a_generator():
    stage = model(Delay(4e-5))
    wrong = replace(stage, dynamics=ElectricVibrationDynamics(
        1.002e-4, (2.0 * np.pi * 700.05,), (0.01995,)))
    recordings = with_generator_edges(wrong, [recorded(stage, NOISE_UM)[0]], [0.0])
    fit = WholeModel(wrong, recordings, [0.0]).fit(wrong, 4e-5, 8)
    assert fit.delayed_model.dynamics.mode_frequencies_rad_per_s == pytest.approx(
        (2.0 * np.pi * 700.0,), rel=1e-4)
    assert fit.delayed_model.dynamics.damping_ratios == pytest.approx((0.02,), rel=1e-2)
    error_um = SimulatedRecording(fit.delayed_model, recordings[0]).error_um()
    assert error_um == pytest.approx(NOISE_UM, rel=0.05)
