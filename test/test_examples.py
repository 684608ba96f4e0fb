# SPDX-License-Identifier: BSD-3-Clause
"""The examples run as they stand, on the simulated stage."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
ON_LEFT = ("--ros-args", "-r", "__ns:=/left")
COVERED = {"identify_and_track", "track_any_trajectory", "play_a_waveform", "analyse_offline",
           "with_the_stage"}
OFFLINE = {"make_recordings", "from_your_data"}
"""Those of test_from_python.py."""


def run_example(name, *arguments):
    """Run an example as a user does; return what it printed."""
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    ended = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", *map(str, arguments)],
        env=environment, capture_output=True, text=True, timeout=1800)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_every_example_has_its_test():
    examples = [*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*.ipynb")]
    assert {path.stem for path in examples} == COVERED | OFFLINE


@pytest.mark.long
def test_notebook_drives_the_stage_and_shows_what_it_did(suite, model, tmp_path):
    printed = suite.beside(
        run_example, "../tools/run_cells", EXAMPLES / "with_the_stage.ipynb", "namespace=left",
        f"folder={tmp_path}", f"model_file={model}")
    assert printed.count("[png, ") == 3
    assert "<IdentifiedModel" not in printed and "mode frequency" in printed
    assert 0.0 < float(printed.split("e_rms ")[1].split(" %")[0]) < 1.0
    assert (tmp_path / "cosine" / "metadata.yaml").exists()


@pytest.mark.long
def test_identify_and_track_takes_recordings_and_tracks_well(suite, identification, tmp_path):
    printed = suite.beside(
        run_example, "identify_and_track", tmp_path, *identification.recordings, *ON_LEFT)
    e_rms_percent = float(printed.split("e_rms ")[1].split(" %")[0])
    assert e_rms_percent < 0.1


@pytest.mark.long
def test_any_trajectory_is_tracked_with_and_without_feedback(suite, model, tmp_path):
    printed = suite.beside(run_example, "track_any_trajectory", model, tmp_path, *ON_LEFT)
    feedforward, composite = (float(line.split("e_rms ")[1].split(" %")[0])
                              for line in printed.splitlines())
    # Without feedback the creep of the runs before shows as an offset of any size.
    assert composite < 0.5 and composite < feedforward


def test_waveform_of_ones_own_is_played_and_read_back(suite, tmp_path):
    printed = suite.beside(run_example, "play_a_waveform", tmp_path, *ON_LEFT)
    assert printed.startswith("4000 samples, ")
    assert (tmp_path / "cosine" / "metadata.yaml").exists()


def test_recordings_and_models_are_analysed_without_ros(identification, monkeypatch, capsys):
    pytest.importorskip("pandas")
    dynamics = next(path for path in identification.recordings if path.name == "dynamics")
    example = EXAMPLES / "analyse_offline.py"
    monkeypatch.setattr(sys, "argv", [str(example), str(dynamics), str(identification.path)])
    runpy.run_path(str(example))  # what it imports is there already
    printed = capsys.readouterr().out
    assert "gaps: []" in printed
    assert "modes at [" in printed
