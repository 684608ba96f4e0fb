# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark of the closed loop takes its speed from what the stage tells while it tracks."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
OWN_MODULES = "loop_speed", "processes", "stage_model"


@pytest.fixture
def speed_of(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import loop_speed

    def speed_of(progress):
        monkeypatch.setattr(loop_speed, "_track", lambda *arguments: progress)
        return loop_speed.closed_loop(tmp_path, 20.0)

    yield speed_of
    for name in OWN_MODULES:
        sys.modules.pop(name)


def test_the_speed_is_that_between_the_first_and_the_last_message(speed_of):
    assert speed_of([(10.0, 40_000), (11.0, 99_999), (12.0, 1_240_000)]) == 15.0


@pytest.mark.parametrize("progress", [[], [(10.0, 40_000)]])
def test_a_loop_that_is_over_before_the_stage_told_twice_is_refused(speed_of, progress):
    with pytest.raises(ValueError, match="track for longer"):
        speed_of(progress)
