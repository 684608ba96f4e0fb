# SPDX-License-Identifier: BSD-3-Clause
"""All nodes over a controller that plays stored waveforms; the controller is a stand-in."""

import signal
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import stored_waveform_node
from action_msgs.msg import GoalStatus
from forked_processes import ForkedProcesses
from probes import SHORT_TONES, write_short_probe

from piezo_client.client import GoalFailed
from piezo_identification.experiments.catalogue import USUAL_LIMITS, multisine
from piezo_recorder.reading.reader import read_recording

ROOT = Path(__file__).parents[1]
RATE_HZ = 10_000.0
LONGEST_SAMPLES = 20_000
ENDS_S = 300.0


def end(block):
    """Return the sample of the clock behind a block at the full rate."""
    return block.first_sample + len(block.voltage_v)


@pytest.fixture(scope="module")
def stage(stage_client, tmp_path_factory):
    directory = tmp_path_factory.mktemp("stored")
    with ForkedProcesses(directory, data_root="/") as processes:
        processes.start_main("stage", stored_waveform_node.main, [
            str(ROOT / "src/piezo_stage_driver/test"),
            str(ROOT / "src/piezo_stage_driver/config/pi_gcs_settings.yaml"),
            str(LONGEST_SAMPLES), "--ros-args", "-r", "__ns:=/stored", "-p", "autostart:=true",
            "-p", "timing:=paced", "-p", f"sample_rate_hz:={RATE_HZ}",
            "-p", "samples_per_tick:=400", "-p", "exchange_timeout_s:=60.0"])
        for name in ("recorder", "identification"):
            processes.start(name, {"autostart": True}, "/stored")
        client = stage_client("/stored", processes)
        client.until(lambda: client.blocks and client.node_names() >= {
            "stage", "recorder", "identification"})
        client.connect_recorder(directory, 1.0 / RATE_HZ, ["samples"])
        yield client
        client.close()
        stage = processes.process("stage")
        stage.send_signal(signal.SIGTERM)
        assert stage.wait(ENDS_S) == 0


def test_experiment_that_fits_the_memory_is_recorded_as_designed(stage, tmp_path):
    limits = replace(USUAL_LIMITS, sample_rate_hz=RATE_HZ)
    write_short_probe(tmp_path, limits)
    result = stage.run_experiment("multisine", tmp_path)
    recording = read_recording(result.recording)
    assert recording.complete and recording.gaps == []
    assert recording.sample_rate_hz == RATE_HZ
    designed = multisine(limits, **SHORT_TONES)
    played = recording.select(recording.playing)
    assert np.allclose(played.voltage_v[:designed.voltage_v.size], designed.voltage_v)
    # The stand-in's stage has 1 um/V and shows each voltage one sample later.
    assert np.allclose(played.displacement_um[1:], played.voltage_v[:-1], atol=1e-4)
    assert recording.voltage_v[-1] == 0.0


@pytest.mark.parametrize(("name", "objection"), [
    ("dynamics", f"{LONGEST_SAMPLES} are what the backend plays at once: shorten it"),
    ("relay", "the backend plays stored waveforms only"),
    ("creep", f"takes 40[0-9]{{5}} samples with its ramps, {LONGEST_SAMPLES} are what"),
])
def test_experiment_that_the_controller_cannot_do_is_refused_by_name(
        stage, tmp_path, name, objection):
    with pytest.raises(GoalFailed, match=objection):
        stage.run_experiment(name, tmp_path)


def test_waveform_is_recorded_sample_by_sample(stage):
    stage.forget()
    waveform_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(2000) / 500.0)
    result = stage.play(waveform_v, 1.0 / RATE_HZ)
    stage.until(lambda: stage.blocks and end(stage.blocks[-1]) > result.last_sample)
    blocks = list(stage.blocks)
    assert all(end(block) == after.first_sample for block, after in pairwise(blocks))
    voltage_v, displacement_um = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("voltage_v", "displacement_um"))
    begin = result.first_sample - blocks[0].first_sample
    assert np.allclose(voltage_v[begin:begin + 2000], waveform_v)
    # The stand-in's stage has 1 um/V and shows each voltage one sample later.
    moved = np.flatnonzero(voltage_v)
    assert np.allclose(displacement_um[moved + 1], voltage_v[moved], atol=1e-4)


def test_what_the_controller_cannot_do_is_refused_by_name(stage):
    goal = stage.send_goal("play_waveform", voltage_v=np.full(LONGEST_SAMPLES, 10.0),
                           sample_period_s=1.0 / RATE_HZ, repeats=1)
    status, result = stage.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert f"{LONGEST_SAMPLES} are what the backend plays at once" in result.message
    loaded = stage.load([0.0, 1.0])
    assert not loaded.success
    assert "stored waveforms only" in loaded.message
