# SPDX-License-Identifier: BSD-3-Clause
"""What identification and controller read and write: files under their data root."""

import os
import resource
import subprocess
from pathlib import Path

import pytest
from piezo_interfaces.srv import AcceptExtendedModel

from piezo_client.client import GoalFailed
from piezo_client.references import harmonic
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_ros.memory_limit import machine_bytes

ROOT = Path(__file__).parents[1]
OUTSIDE = "is outside"
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


def test_goals_that_read_what_is_no_bounded_file_of_the_root_are_refused(rooted, root, tmp_path):
    (tmp_path / "model.json").write_text((root / "model.json").read_text())
    (root / "elsewhere.json").symlink_to(tmp_path / "model.json")
    (root / "zero.json").symlink_to("/dev/zero")
    os.mkfifo(root / "pipe")
    for folder in "bag", "runs":
        (root / folder).mkdir(exist_ok=True)
    (root / "bag" / "metadata.yaml").symlink_to("/dev/zero")
    with open(root / "sparse", "wb") as file:
        file.truncate(2 * 2**30)
    model = root / "model.json"
    wrong = {tmp_path / "model.json": OUTSIDE, root / "elsewhere.json": OUTSIDE,
             "/dev/zero": OUTSIDE, root / "zero.json": OUTSIDE, root / "pipe": "is a pipe",
             root / "runs": "is a directory", root / "sparse": "more than the"}

    def refused(name, *arguments, **options):
        with pytest.raises(GoalFailed) as failed:
            getattr(rooted, name)(*arguments, root, **options)
        assert str(failed.value).isprintable()
        return str(failed.value)

    def refused_as_data(path):
        return [refused("diagnose", model, [path]),
                refused("track", {"kind": "file", "file": str(path)}, model, "feedforward", 0.1)]

    for path, reason in wrong.items():
        accepted = rooted.call(AcceptExtendedModel, "controller/accept_extended_model",
                               model=str(model), extended_model=str(path))
        assert not accepted.success
        said = [accepted.message, refused("track", REFERENCE, path, "open_loop", 0.1),
                refused("track", REFERENCE, model, "composite", 0.1, controller=path),
                refused("diagnose", path, [model])]
        if reason in (OUTSIDE, "is a pipe"):  # recordings may be directories, and large
            said += refused_as_data(path)
        assert [text for text in said if reason not in text] == []
    refused_as_data(root / "sparse")
    assert OUTSIDE in refused("diagnose", model, [root / "bag"])


def test_nodes_have_a_limit_of_memory_and_end_before_the_stage(rooted):
    stage, *others = (rooted.processes.process(name).pid for name in (
        "stage", "recorder", "identification", "controller"))
    scores = [int(Path(f"/proc/{pid}/oom_score_adj").read_text()) for pid in (stage, *others)]
    assert all(score > scores[0] for score in scores[1:])
    for pid in others:
        soft, _ = resource.prlimit(pid, resource.RLIMIT_DATA)
        assert soft == machine_bytes() // 2


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
