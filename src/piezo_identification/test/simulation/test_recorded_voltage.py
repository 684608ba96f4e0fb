# SPDX-License-Identifier: BSD-3-Clause
"""A recorded voltage between its rows, beside tones that are known there."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.fitting.structure_search import begun, best_of
from piezo_identification.fitting.whole_model import WholeModel
from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, GAIN_UM_PER_V, NOISE_UM = 1e-3, 0.5, 2e-3
HELD = StageModel(
    PreisachModel(-60.0, 60.0, np.zeros((1, 1)), 0.0, np.array([GAIN_UM_PER_V])), CreepDynamics(),
    ElectricVibrationDynamics(0.0, (700.0,), (0.05,)))
SMOOTH = replace(HELD, effects=(BandLimitedVoltage(),))


def tones(rows, of_each=1.0):
    """Tones up to 0.37 of the rate of the rows, each with a complex factor."""
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, RATES.size)
    return np.real(np.exp(1j * (np.multiply.outer(PERIOD_S * rows, RATES) + phases)) @ (
        of_each * np.ones(RATES.size)))


RATES = 2.0 * np.pi / PERIOD_S * np.linspace(0.013, 0.37, 25)


@pytest.fixture(scope="module")
def measured():
    """A stage in steady motion, read by a logger that filters both signals."""
    rows = np.arange(3000)
    noise = NOISE_UM * np.random.default_rng(1).normal(size=rows.size)
    moved_um = GAIN_UM_PER_V * tones(rows, HELD.response(RATES / (2.0 * np.pi)))
    return Recording(
        "tones.csv", 1.0 / PERIOD_S, rows, np.full(rows.size, PERIOD_S), tones(rows),
        moved_um + noise, np.full(rows.size, Flag.PLAYING, dtype=np.uint32))


def left_um(model, recording):
    prediction = predict(model, recording)
    return np.std((prediction.measured_um - prediction.simulated_um)[500:-500])


def test_a_smooth_voltage_is_answered_as_in_continuous_time(measured):
    assert left_um(SMOOTH, measured) < 1.1 * NOISE_UM
    assert left_um(HELD, measured) > 20.0 * NOISE_UM


def test_a_smooth_voltage_is_found_and_a_held_one_is_not_called_smooth(measured):
    wrong = replace(HELD, dynamics=ElectricVibrationDynamics(0.0, (720.0,), (0.06,)))
    noise = NOISE_UM * np.random.default_rng(2).normal(size=measured.voltage_v.size)
    held = replace(
        measured, displacement_um=HELD.simulate(measured.voltage_v, PERIOD_S) + noise)
    for recording, effects in ((measured, SMOOTH.effects), (held, ())):
        found, _ = begun(WholeModel(wrong, [recording], [0.0]), wrong, None)
        best = best_of([fit for _, fit in found])
        assert best.model.effects == effects
        assert best.model.dynamics.mode_frequencies_rad_per_s == pytest.approx([700.0], rel=1e-3)
