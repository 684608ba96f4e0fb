# SPDX-License-Identifier: BSD-3-Clause
"""Goals of an hour, and streams that go out of reach on their way, through the real nodes."""

import numpy as np
import pytest
from piezo_interfaces.msg import Reference

from piezo_client.client import GoalFailed
from piezo_recorder.reading.reader import read_recording

CENTRE_UM = 57.0
HOUR_S = 3600.0
# The feedforward alone is on target from the beginning on.
TOLERANCE_UM = 5.0
SLOW = {"kind": "harmonic", "frequency_hz": [0.01], "amplitude_um": [40.0], "centre_um": CENTRE_UM}
PERIODIC = {**SLOW, "frequency_hz": [100.0]}


@pytest.mark.parametrize("reference", [SLOW, PERIODIC], ids=["streamed", "periodic"])
def test_goal_of_an_hour_tells_that_it_is_planned_then_plays_and_is_cancelled(
        suite, model, tmp_path, reference):
    told = []
    handle = suite.send(
        "track", told.append, reference=Reference(**reference), model=str(model),
        mode="feedforward", duration_s=HOUR_S, directory=str(tmp_path), tolerance_um=TOLERANCE_UM)
    suite.until(lambda: told and told[-1].stage == "play" and told[-1].on_target)
    handle.cancel_goal_async()
    message = suite.wait(handle.get_result_async()).result
    assert message.message == "cancelled"
    stages = [feedback.stage for feedback in told]
    assert stages[0] == "plan" and stages.index("play") == stages.count("plan")
    assert {feedback.tolerance_um for feedback in told} == {TOLERANCE_UM}
    assert read_recording(message.recording).gaps == []
    assert suite.play([0.0]).success


@pytest.mark.long
def test_stream_that_goes_out_of_reach_ends_at_rest_within_the_limits_and_tells_when(
        suite, model, tmp_path):
    # What is checked before the run ends at 20 s; the way steps beyond the range at 20.2 s.
    way_um = np.zeros(round(20.5 * 40_000))
    way_um[round(20.2 * 40_000):] = 30.0
    file = tmp_path / "way.csv"
    np.savetxt(file, np.column_stack([np.arange(way_um.size) / 40_000, way_um]), fmt="%.9g",
               delimiter=",", header="time_s,displacement_um", comments="")
    reference = Reference(kind="file", file=str(file), once=True, centre_um=CENTRE_UM)
    with pytest.raises(GoalFailed, match="cannot follow the reference between 20.15 and 20.25 s"):
        suite.goal("track", reference=reference, model=str(model), mode="feedforward",
                   duration_s=20.5, directory=str(tmp_path))
    samples = suite.samples()
    assert samples.gapless
    assert samples.voltage_v[-1] == 0.0
    assert samples.voltage_v.max() < 120.0
    assert np.abs(np.diff(samples.voltage_v)).max() < 1.0
