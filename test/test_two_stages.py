# SPDX-License-Identifier: BSD-3-Clause
"""Two stages on one machine, each in its namespace, track side by side."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from piezo_client.references import harmonic
from piezo_client.stage import Stage


@pytest.fixture(scope="module")
def right(nodes):
    """Client of a second stage, with a noise of its own."""
    return nodes.start("recorder", "controller", namespace="/right", seed=2)


class Side:
    """A stage that tracks, from within the run of another one if it is given.

    Attributes
    ----------
    moves, ended : Event
    within : bool
        Whether the other run had not ended before this one did.
    """

    def __init__(self, namespace, frequency_hz, duration_s, after=None):
        self._namespace = namespace
        self._after = after
        self._frequency_hz = frequency_hz
        self._duration_s = duration_s
        self._designed, self.moves, self.ended = Event(), Event(), Event()

    def tell(self, step, fraction, seconds_left):
        if self._designed.is_set() and step.endswith("play"):
            self.moves.set()

    def track(self, model, directory):
        reference = harmonic(self._frequency_hz, 20.0, 50.0)
        with Stage(self._namespace, progress=self.tell) as stage:
            # The controller keeps its design for the next run.
            stage.track(reference, model, duration_s=0.05, directory=directory)
            self._designed.set()
            if self._after:
                assert self._after.moves.wait(120)
            run = stage.track(
                reference, model, duration_s=self._duration_s, directory=directory)
        self.within = self._after is not None and not self._after.ended.is_set()
        self.ended.set()
        return run


def track_side_by_side(sides, model, directory):
    """Track with all sides; return their runs."""
    with ThreadPoolExecutor() as threads:
        runs = [threads.submit(side.track, model, directory / str(number))
                for number, side in enumerate(sides)]
        return [run.result() for run in runs]


def test_two_stages_track_different_references_at_the_same_time(suite, right, model, tmp_path):
    long = Side("/right", 200.0, 30.0)
    short = Side("/left", 100.0, 0.25, after=long)
    sides = long, short
    runs = suite.beside(right.beside, track_side_by_side, sides, model, tmp_path)
    assert short.within
    for number, run in enumerate(runs):
        assert run.path.parent == tmp_path / str(number)
        assert run.e_rms_percent < 0.5
        assert run.missed_feedback == 0
        assert run.recording().gaps == []
