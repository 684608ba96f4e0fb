# SPDX-License-Identifier: BSD-3-Clause
"""A stage that is ended returns to rest, tells its client, and leaves a whole recording."""

import signal

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from piezo_interfaces.srv import StartRecording, StopRecording

from piezo_recorder.reading.reader import read_recording


@pytest.mark.parametrize(("number", "timing", "kind"), [
    (signal.SIGINT, "lockstep", "executables"), (signal.SIGTERM, "paced", "nodes")])
def test_stage_that_is_ended_in_a_waveform_ends_in_order(
        request, tmp_path, number, timing, kind):
    # In ticks of 10 ms, of which a paced stage keeps 20 s for a recorder on a busy computer.
    stage = request.getfixturevalue(kind).start(
        "recorder", namespace=f"/{number.name}_{timing}".lower(), timing=timing,
        samples_per_tick=400)
    started = stage.call(StartRecording, "recorder/start_recording",
                         directory=str(tmp_path), name="run")
    assert started.success, started.message
    goal = stage.begin_play(np.full(4000, 60.0), repeats=1_000_000)

    process = stage.processes.process("stage")
    process.send_signal(number)
    status, result = stage.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "the stage node was ended"
    stage.until(lambda: process.poll() is not None)
    assert process.returncode == 0

    stopped = stage.call(StopRecording, "recorder/stop_recording", last_sample=result.last_sample)
    assert stopped.success, stopped.message
    recording = read_recording(stopped.path)
    assert recording.gaps == []
    assert recording.sample_index[-1] == result.last_sample
    assert recording.voltage_v.max() > 0.0
    assert recording.voltage_v[-1] == 0.0
    assert np.abs(np.diff(recording.voltage_v)).max() < 0.051  # 2000 V/s
