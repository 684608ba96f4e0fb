# SPDX-License-Identifier: BSD-3-Clause
"""References that are streamed to the stage, and one that is learned, through the real nodes."""

import json
import math

import numpy as np
import pytest
from piezo_interfaces.msg import Reference

from piezo_client.client import GoalFailed
from piezo_recorder.reading.reader import read_recording

CENTRE_UM = 57.0


def harmonic(frequency_hz=100.0, amplitude_um=40.0):
    return {"kind": "harmonic", "frequency_hz": [frequency_hz], "amplitude_um": [amplitude_um],
            "centre_um": CENTRE_UM}


RANDOM = {"kind": "random", "frequency_hz": [300.0], "amplitude_um": [30.0],
          "centre_um": CENTRE_UM, "seed": 4}
RASTER = {"kind": "raster", "frequency_hz": [500.0], "amplitude_um": [20.0],
          "centre_um": CENTRE_UM, "axis": "slow"}


def test_random_reference_is_streamed_and_tracked_while_the_settling_is_told(
        suite, model, tmp_path):
    told = []
    result = suite.track(RANDOM, model, "composite", 0.3, tmp_path, on_feedback=told.append,
                         tolerance_um=0.5)
    assert result.e_rms_percent < 0.5
    assert result.missed_feedback == 0
    assert 0.0 <= result.settled_after_s < 0.1
    assert {feedback.tolerance_um for feedback in told} == {0.5}
    assert told[-1].on_target
    recording = read_recording(result.recording)
    assert recording.gaps == []
    assert recording.tracking.sum() > 0.3 * 40_000


def test_same_stream_gives_the_same_voltages_to_the_bit(suite, model, tmp_path):
    voltages_v = []
    for name in ("one", "two"):
        result = suite.track(harmonic(0.01), model, "feedforward", 0.1, tmp_path / name)
        recording = read_recording(result.recording)
        voltages_v.append(recording.voltage_v[recording.tracking])
    assert np.array_equal(*voltages_v)


def test_frame_of_512_lines_is_scanned(suite, model, tmp_path):
    result = suite.track(RASTER, model, "composite", 512 / 500, tmp_path)
    assert result.e_rms_percent < 0.2
    assert not math.isnan(result.settled_after_s)


def test_voltage_does_not_jump_from_one_reference_to_the_next(suite, model, tmp_path):
    parts = [harmonic(), RANDOM, harmonic(200.0, 20.0)]
    result = suite.track(
        parts[0], model, "composite", 0.1, tmp_path, then=[Reference(**p) for p in parts[1:]],
        then_duration_s=[0.1, 0.1])
    assert result.e_rms_percent < 0.5
    recording = read_recording(result.recording)
    steps_v = np.abs(np.diff(recording.voltage_v))
    alone_v = []
    for part in parts:
        single = read_recording(
            suite.track(part, model, "composite", 0.1, tmp_path / str(len(alone_v))).recording)
        alone_v.append(np.abs(np.diff(single.voltage_v)).max())
    assert steps_v.max() < 1.2 * max(alone_v)
    assert json.loads(recording.attachments["parameters.json"])["then"][0]["kind"] == "random"


@pytest.mark.parametrize("inversion", ["zero_phase", "derivatives"])
def test_online_inverses_track_a_harmonic_as_the_exact_one_does(
        suite, model, tmp_path, inversion):
    result = suite.track(harmonic(), model, "composite", 0.3, tmp_path, inversion=inversion)
    assert result.e_rms_percent < 0.2


def error_before_learning_um(result):
    """RMS error, settled, of the 0.1 s before the first iteration can act."""
    recording = read_recording(result.recording)
    error_um = (recording.displacement_um - recording.reference_um)[recording.tracking]
    return error_um[16_000:20_000].std()


def test_learning_reaches_the_noise_and_begins_there_the_next_time(suite, model, tmp_path):
    told = []
    first = suite.track(harmonic(), model, "learning", 0.2, tmp_path, on_feedback=told.append)
    assert 2 <= first.iterations <= 10
    assert f"learning ended after {first.iterations} iterations" in first.message
    recording = read_recording(first.recording)
    assert recording.gaps == []
    assert max(feedback.iteration for feedback in told) >= 1
    # 9 nm of noise are 0.0225 % of 40 um.
    assert first.e_rms_percent < 0.025
    second = suite.track(harmonic(), model, "learning", 0.2, tmp_path)
    assert second.learned == first.learned
    assert second.e_rms_percent < 0.025
    # The noise has 0.009 um.
    assert error_before_learning_um(second) < min(error_before_learning_um(first), 0.011)


@pytest.mark.parametrize(("fields", "sentence"), [
    ({"then": [Reference(**RANDOM)], "then_duration_s": [1.0]}, "learning repeats one reference"),
    ({"learned": "/no/learned.json"}, "the learned feedforward '/no/learned.json': cannot be read"),
    ({"reference": Reference(**RANDOM)}, "random reference that is not repeated has no period"),
    ({"mode": "open_loop", "inversion": "zero_phase"}, "open_loop plays one reference"),
    ({"mode": "feedforward", "inversion": "magic"}, "unknown inversion 'magic'"),
    ({"mode": "feedforward", "then": [Reference(**RANDOM)]}, "give one for each"),
    ({"tolerance_um": -1.0}, "tolerance_um is -1"),
])
def test_goal_that_makes_no_sense_is_refused_and_nothing_moves(
        suite, model, tmp_path, fields, sentence):
    goal = {"reference": Reference(**harmonic()), "model": str(model), "mode": "learning",
            "duration_s": 0.5, "directory": str(tmp_path), **fields}
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed) as failure:
        suite.goal("track", **goal)
    assert sentence in failure.value.result.message
    assert list(tmp_path.iterdir()) == []
    assert suite.play([0.0]).first_sample == before + 1
