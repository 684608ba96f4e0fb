# SPDX-License-Identifier: BSD-3-Clause
"""A feedforward that grows while it plays takes no more than what is loaded ahead."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.sources import Feedforward
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import VoltageLimits

CHUNK = 400


class Sink:
    """A backend that forgets what it is given."""

    sample_rate_hz = 40000.0

    def exchange(self, voltage_v):
        return voltage_v


def held_bytes(instance):
    """Return the bytes of all arrays that an object keeps."""
    kept = [*vars(instance).values(), *instance._appended]
    return sum(sys.getsizeof(value) for value in kept if isinstance(value, np.ndarray))


@given(st.lists(st.integers(1, 90), min_size=1, max_size=12),
       st.lists(st.integers(1, 70), min_size=1, max_size=25))
def test_stream_is_played_to_the_sample_whatever_is_appended_and_taken_at_once(chunks, counts):
    stream_v = np.arange(float(sum(chunks)))
    first, *others = np.split(stream_v, np.cumsum(chunks)[:-1])
    source = Feedforward(first, np.empty(0))
    for chunk in others:
        source.append(chunk)
    taken = np.concatenate([source.take(count) for count in counts])
    expected = stream_v[np.minimum(np.arange(sum(counts)), stream_v.size - 1)]
    np.testing.assert_array_equal(taken, expected)
    assert source.last_v == stream_v[-1]
    played = sum(counts[:-1])
    assert source.exhausted == (max(played, 0) + counts[-1] > stream_v.size)


@given(st.integers(0, 50), st.integers(1, 30), st.lists(st.integers(1, 70), min_size=1))
def test_period_is_repeated_behind_the_once_part(once, period, counts):
    source = Feedforward(np.arange(float(once)), 100.0 + np.arange(float(period)))
    for _ in range(2):
        taken = np.concatenate([source.take(count) for count in counts])
        expected = np.r_[np.arange(float(once)), np.resize(100.0 + np.arange(period), taken.size)]
        np.testing.assert_array_equal(taken, expected[:taken.size])
        assert not source.exhausted
        source.rewind()


def test_what_was_played_is_forgotten():
    source = Feedforward(np.zeros(CHUNK), np.empty(0))
    sizes = []
    for _ in range(500):
        source.append(np.ones(CHUNK))
        source.take(CHUNK)
        sizes.append(held_bytes(source))
    assert max(sizes) == sizes[0]


def test_stream_that_ran_dry_goes_on_where_it_stopped():
    source = Feedforward(np.arange(4.0), np.empty(0))
    np.testing.assert_array_equal(source.take(6), [0, 1, 2, 3, 3, 3])
    assert source.exhausted
    source.append(np.arange(4.0, 7.0))
    np.testing.assert_array_equal(source.take(2), [4, 5])
    assert not source.exhausted


def test_played_stream_does_not_begin_anew_without_its_beginning():
    engine = StageEngine(Sink(), VoltageLimits(-20.0, 120.0, 2.0e6))
    engine.commands.load_feedforward(np.zeros(40), [])
    engine.commands.load_feedforward(np.full(40, 1.0), [], append=True)
    for ticks in (1, 2):  # the first run ends before what was appended
        engine.commands.start_tracking(feedback=False, ticks=ticks)
        while not engine.idle:
            engine.advance()
    with pytest.raises(StageRefusal, match="has been played: load it again"):
        engine.commands.start_tracking(feedback=False, ticks=1)
    engine.commands.load_feedforward(np.zeros(40), [])
    engine.commands.start_tracking(feedback=False, ticks=1)
