# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark of the closed loop: what the stage tells makes its speed, and no run is refused."""

import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
OWN_MODULES = "loop_speed", "stage_model"


@pytest.fixture
def loop_speed(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import loop_speed

    yield loop_speed
    for name in OWN_MODULES:
        sys.modules.pop(name)


@pytest.fixture
def speed_of(loop_speed, monkeypatch, tmp_path):
    def speed_of(progress):
        monkeypatch.setattr(loop_speed, "_track", lambda *arguments: progress)
        return loop_speed.closed_loop(tmp_path, 20.0, {})

    return speed_of


def test_the_speed_is_that_between_the_first_and_the_last_message(speed_of):
    assert speed_of([(10.0, 40_000), (11.0, 99_999), (12.0, 1_240_000)]) == 15.0


@pytest.mark.parametrize("progress", [[], [(10.0, 40_000)]])
def test_a_loop_that_is_over_before_the_stage_told_twice_is_refused(speed_of, progress):
    with pytest.raises(ValueError, match="track for longer"):
        speed_of(progress)


def test_round_trips_are_timed_however_many_answers_are_late(loop_speed, monkeypatch, tmp_path):
    def track(directory, duration_s, executables, stage):
        assert executables["controller"]["max_late_percent"] == 100.0
        np.save(stage["round_trips_file"], np.arange(502.0))

    monkeypatch.setattr(loop_speed, "_track", track)
    assert loop_speed.tick_round_trips(tmp_path, 5.0).tolist() == [500.0, 501.0]
