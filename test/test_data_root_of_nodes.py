# SPDX-License-Identifier: BSD-3-Clause
"""Where identification and controller write: under their data root, whatever a goal names."""

import os
import subprocess
from pathlib import Path

import pytest

from piezo_client.client import GoalFailed
from piezo_client.references import harmonic
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model

ROOT = Path(__file__).parents[1]
REFERENCE = harmonic(100.0, 5.0, 50.0)


@pytest.fixture(scope="module")
def root(tmp_path_factory, plain_model):
    root = tmp_path_factory.mktemp("root")
    save_model(root / "model.json", IdentifiedModel(plain_model, (-20.0, 120.0), {}, {}, []))
    return root


@pytest.fixture(scope="module")
def rooted(nodes, root):
    """Client of nodes that write under a folder of their own."""
    return nodes.start("recorder", "identification", "controller", namespace="/rooted",
                       node_parameters={name: {"data_root": root}
                                        for name in ("identification", "controller")})


def test_goals_that_write_elsewhere_are_refused_and_leave_nothing(rooted, root, tmp_path):
    (root / "link").symlink_to(tmp_path)
    (root / "diagnosis").mkdir()
    (root / "diagnosis" / "report.html").symlink_to(tmp_path / "report.html")
    model, recording = root / "model.json", root / "recording"
    for goal in (
            lambda: rooted.run_experiment("dynamics", tmp_path),
            lambda: rooted.run_experiment("dynamics", root / ".." / tmp_path.name),
            lambda: rooted.identify(root / "link"),
            lambda: rooted.diagnose(model, [recording], tmp_path),
            lambda: rooted.diagnose(model, [recording], root / "diagnosis"),
            lambda: rooted.track(REFERENCE, model, "open_loop", 0.1, tmp_path),
            lambda: rooted.track(REFERENCE, model, "learning", 0.1, root,
                                 learned=str(tmp_path / "learned.json"))):
        with pytest.raises(GoalFailed) as refused:
            goal()
        assert f"is outside {root}" in str(refused.value)
        assert "data_root" in str(refused.value)
        assert str(refused.value).isprintable()
    assert not [*tmp_path.iterdir()]


def test_relative_paths_of_a_goal_are_of_the_data_root(rooted, root, monkeypatch):
    # As `ros2 action send_goal` passes what was typed.
    monkeypatch.setattr("piezo_client.client.with_absolute_paths", dict)
    result = rooted.track(REFERENCE, "model.json", "open_loop", 0.1, "runs/first")
    assert Path(result.recording) == root / "runs" / "first" / "track_open_loop"
    assert (Path(result.recording) / "metadata.yaml").is_file()


def test_relative_paths_of_the_python_client_are_of_the_caller(rooted, root, monkeypatch):
    (root / "desk").mkdir()
    monkeypatch.chdir(root / "desk")
    result = rooted.track(REFERENCE, "../model.json", "open_loop", 0.1, "runs")
    assert Path(result.recording) == root / "desk" / "runs" / "track_open_loop"


def test_run_works_in_the_folder_of_the_caller(tmp_path, save_csv):
    time_s = [0.0, 1e-3, 2e-3]
    save_csv(tmp_path / "data.csv", time_s, [0.0, 1.0, 2.0], [0.0, 0.1, 0.2])
    environment = {name: value for name, value in os.environ.items()
                   if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(
        [ROOT / "run", "piezo_recorder", "report", "data.csv"], cwd=tmp_path, env=environment,
        capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "data.csv" in done.stdout
