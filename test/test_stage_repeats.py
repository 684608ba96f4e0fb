# SPDX-License-Identifier: BSD-3-Clause
"""In lockstep the same seed and the same commands give the same samples to the bit."""

import numpy as np
import pytest


def run(stage):
    """Play and track with feedback from a fresh start; return every sample of it."""
    waveform = 50 + 40 * np.sin(2 * np.pi * np.arange(2000) / 2000)
    played = stage.play(waveform, repeats=2)
    slow = stage.play(waveform, sample_period_s=0.001)
    stage.answer = lambda block: 0.1 * (20.0 - np.mean(block.displacement_um))
    assert stage.load(np.linspace(0, 30, 4000), 30 + np.sin(2 * np.pi * np.arange(40) / 40)).success
    first_tick = stage.start_tracking(feedback=True, ticks=300).first_tick
    stage.samples(40 * first_tick + 300 * 40)  # the run is over, the way to rest has begun
    samples = stage.samples()
    assert samples.gapless
    assert played.last_sample < slow.first_sample < 40 * first_tick
    return samples


@pytest.fixture(scope="module")
def runs(nodes):
    """The same commands to three fresh stages, the third of another seed."""
    stages = [nodes.start(namespace=namespace, connect=False, seed=seed)
              for namespace, seed in [("/first", 5), ("/again", 5), ("/other", 6)]]
    for stage in stages:
        stage.connect()
        # Begin anew, however long the connecting took.
        stage.restart()
    return [run(stage) for stage in stages]


def test_same_seed_gives_the_same_samples_to_the_bit(runs):
    first, again, _ = runs
    assert np.array_equal(first.voltage_v, again.voltage_v)
    assert np.array_equal(first.displacement_um, again.displacement_um)
    assert [block.flags for block in first.blocks] == [block.flags for block in again.blocks]
    assert [block.header.stamp for block in first.blocks] == [
        block.header.stamp for block in again.blocks]


def test_another_seed_gives_other_samples(runs):
    first, _, other = runs
    count = min(len(first.displacement_um), len(other.displacement_um))
    differs = first.displacement_um[:count] != other.displacement_um[:count]
    assert differs.mean() > 0.5
