# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.conditioning.generator_edges import free_running_level
from piezo_identification.conditioning.waveforms import SquareWave
from piezo_identification.identification.identify import identify
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag


def sampled(edges, count):
    """A level of 1 between each odd edge and the next, as samples show it."""
    level = (np.searchsorted(edges, np.arange(count), side="right") % 2).astype(float)
    return SquareWave(level, np.flatnonzero(np.diff(level)) + 1)


def edges_of(period, duty, first, count):
    rises = first + period * np.arange(int(count / period) + 1)
    edges = np.sort(np.concatenate([rises, rises + duty * period]))
    return edges[edges < count - 1]


@pytest.mark.parametrize("period, duty", [(301.37, 0.45), (300.17, 0.5), (87.43, 0.3)])
def test_the_edges_of_a_generator_are_found_between_the_samples(period, duty):
    edges = edges_of(period, duty, 20.7, 12_000)
    wave = sampled(edges, 12_000)
    level = free_running_level(wave)
    added = np.abs(level - wave.level)
    before, after = added[wave.steps - 1], added[wave.steps]
    earlier = wave.steps - edges
    np.testing.assert_allclose(before + after, earlier, atol=0.06)
    # The centre of what is added is that of the part of a period by which the step was earlier.
    np.testing.assert_allclose(before - after, earlier**2, atol=0.06)
    beside = np.append(wave.steps, wave.steps - 1)
    np.testing.assert_array_equal(np.delete(level, beside), np.delete(wave.level, beside))


def test_no_edges_are_sought_where_the_period_is_whole_or_there_is_none():
    assert free_running_level(sampled(edges_of(300.0, 0.5, 20.0, 6000), 6000)) is None
    steps = np.random.default_rng(1).uniform(100.0, 400.0, 20).cumsum()
    assert free_running_level(sampled(steps, 6000)) is None


def test_the_creep_under_a_free_running_generator_is_adequate():
    period_s, count, fine = 0.05, 12_000, 20
    edges = edges_of(1003.27, 0.45, 411.3, count)
    level = (np.searchsorted(edges, np.arange(count * fine) / fine, side="right") % 2) * 20.0
    decay = np.exp(-0.8 * period_s / fine)
    creeping = lfilter([0.0, 1.0 - decay], [1.0, -decay], level)
    noise = np.random.default_rng(1).normal(scale=0.003, size=count)
    recording = Recording(
        path=__file__, sample_rate_hz=1.0 / period_s, sample_index=np.arange(count),
        sample_periods_s=np.full(count, period_s), voltage_v=20.0 + 2.0 * level[::fine],
        displacement_um=(level + 0.05 * creeping)[::fine] + noise,
        flags=np.full(count, Flag.PLAYING, dtype=np.uint32))
    identified = identify(creep=recording)
    creep = identified.model.creep
    assert creep.poles_rad_per_s == pytest.approx((0.8,), rel=2e-3)
    assert creep.zeros_rad_per_s == pytest.approx((0.84,), rel=2e-3)
    assert identified.adequacy["creep"]["verdict"] == "adequate"
