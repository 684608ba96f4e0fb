# SPDX-License-Identifier: BSD-3-Clause
"""Lags on both sides of the hysteresis, by play operators on a grid of time four times finer."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.identify import identify
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, FINE, PERIODS = 25e-6, 4, 22
LAG_BEHIND_S, MODE, NOISE_UM = 2e-4, (4000.0, 0.1, 1.0), 0.009
PLAYS = {"gains_um_per_v": (0.5, *(0.06,) * 8), "half_widths_v": (0.0, *np.arange(2.0, 26.0, 3.0))}

GRID = DensityOptions(grid=40, smoothing_weight=1e-9, translation_weight=1e-9)


def lagged(voltage_v, lag_s):
    """A held voltage behind a lag, on the fine grid: means over its steps."""
    fine_v = np.repeat(voltage_v, FINE)
    if not lag_s:
        return fine_v
    decay = np.exp(-PERIOD_S / FINE / lag_s)
    return lfilter([1.0 - decay], [1.0, -decay], fine_v - fine_v[0]) + fine_v[0]


def recording(voltage_v, sample_period_s, displacement_um):
    noise_um = NOISE_UM * np.random.default_rng(3).normal(size=voltage_v.size)
    return Recording(
        __file__, 1.0 / sample_period_s, np.arange(voltage_v.size),
        np.full(voltage_v.size, sample_period_s), voltage_v, displacement_um + noise_um,
        np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))


def square_wave(lag_s):
    stage = IndependentStage(LAG_BEHIND_S, (MODE,), **PLAYS)
    voltage_v = square_wave_v(periods=PERIODS)
    displacement_um = stage.displacement_um(lagged(voltage_v, lag_s), PERIOD_S / FINE)[::FINE]
    return recording(voltage_v, PERIOD_S, displacement_um)


def loops():
    """Slow cycles of rising amplitude, on which no lag shows."""
    stage = IndependentStage(LAG_BEHIND_S, (MODE,), **PLAYS)
    corners_v = [0.0]
    for height_v in np.arange(10.0, 101.0, 10.0):
        corners_v += [height_v, 0.0]
    times = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners_v)))])
    voltage_v = np.interp(np.arange(0.0, times[-1], 0.5), times, corners_v)
    return recording(voltage_v, 0.1, stage.hysteresis_um(voltage_v))


@pytest.mark.long
@pytest.mark.parametrize(("lag_s", "names"), [(3.3e-5, ["amplifier_lag"]), (0.0, [])])
def test_identify_names_a_lag_in_front_only_where_there_is_one(lag_s, names):
    found = identify(hysteresis=loops(), dynamics=square_wave(lag_s), density=GRID,
                     order=ResponseOrder(None, 1, None)).model
    lags = [effect for effect in found.effects if effect.name == "amplifier_lag"]
    assert [lag.name for lag in lags] == names
    assert [lag.time_constant_s for lag in lags] == pytest.approx([lag_s] * len(names), rel=0.1)
