# SPDX-License-Identifier: BSD-3-Clause
"""A stream keeps so much loaded ahead and no more, and holds answers back below that."""

import pytest

from piezo_ros.stage_runs.streaming import AHEAD_SAMPLES, LEAST_AHEAD_SAMPLES, Stream

CHUNK, BLOCK = 4000, 40


class Stage:
    """Counts what it is given."""

    def __init__(self):
        self.loaded, self.largest_ahead, self.answered = BLOCK, 0, []

    def append(self, voltage_v):
        self.loaded += len(voltage_v)
        played = BLOCK * len(self.answered)
        self.largest_ahead = max(self.largest_ahead, self.loaded - played)

    def answer(self, tick, voltage_v):
        self.answered.append((tick, voltage_v))


@pytest.fixture
def stage():
    return Stage()


def test_stream_never_has_more_loaded_than_is_to_be(stage):
    chunks = iter([[0.0] * CHUNK] * 1000 + [[]])
    stream = Stream(lambda: next(chunks), BLOCK, stage.append, stage.answer)
    stream.feed()
    ticks = 0
    while stream.wants_more or stage.loaded > BLOCK * ticks:
        ticks += 1
        stream.answer(ticks, 0.5, BLOCK)
        stream.feed()
    assert stage.largest_ahead <= AHEAD_SAMPLES + CHUNK
    assert stage.loaded == BLOCK + 1000 * CHUNK
    assert stage.answered == [(tick, 0.5) for tick in range(1, ticks + 1)]


def test_answers_are_held_back_until_enough_is_loaded(stage):
    chunks = iter([[0.0] * LEAST_AHEAD_SAMPLES, None, [0.0] * CHUNK, []])
    stream = Stream(lambda: next(chunks), BLOCK, stage.append, stage.answer)
    stream.feed()  # the second chunk cannot be told yet
    stream.answer(1, 1.0, BLOCK)
    stream.answer(2, 2.0, BLOCK)
    stream.answer(3, 3.0, BLOCK)  # of a stage that plays on before it misses the one before
    assert stage.answered == [(1, 1.0)]
    stream.feed()
    assert stage.answered == [(1, 1.0), (2, 2.0), (3, 3.0)]


def test_chunk_that_cannot_be_computed_is_told_and_loads_nothing(stage):
    def more():
        raise ValueError("out of reach")

    stream = Stream(more, BLOCK, stage.append, stage.answer)
    with pytest.raises(ValueError, match="out of reach"):
        stream.feed()
    assert stage.loaded == BLOCK
