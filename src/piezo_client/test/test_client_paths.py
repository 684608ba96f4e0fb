# SPDX-License-Identifier: BSD-3-Clause
"""Paths are made absolute where the caller is, for nodes that work in another folder."""

from pathlib import Path

import pytest
from piezo_interfaces.msg import Reference

from piezo_client.client import Client
from piezo_client.paths import absolute, with_absolute_paths


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Path.cwd()


def test_paths_of_every_kind_become_those_of_the_caller(here):
    reference = Reference(kind="file", file="way.csv")
    fields = {
        "directory": Path("runs"), "model": "model.json", "holdout": "../held.csv",
        "learned": "/abs/learned.json", "controller": "controller.json",
        "recordings": ["a", Path("b"), "/c"],
        "reference": reference, "then": [Reference(kind="file", file="next.csv"), Reference()],
        "mode": "composite", "name": "run"}
    made = with_absolute_paths(fields)
    assert made["directory"] == f"{here}/runs"
    assert made["model"] == f"{here}/model.json"
    assert Path(made["holdout"]).resolve() == here.parent / "held.csv"
    assert made["learned"] == "/abs/learned.json"
    assert made["controller"] == f"{here}/controller.json"
    assert made["recordings"] == [f"{here}/a", f"{here}/b", "/c"]
    assert made["reference"].file == f"{here}/way.csv"
    assert [following.file for following in made["then"]] == [f"{here}/next.csv", ""]
    assert (made["mode"], made["name"]) == ("composite", "run")
    assert reference.file == "way.csv"
    assert with_absolute_paths({}) == {}


def test_no_path_stays_none(here):
    assert absolute("") == ""
    assert with_absolute_paths({"directory": "", "recordings": []}) == {
        "directory": "", "recordings": []}


class SentGoal(Exception):
    """What the action's goal would hold."""


@pytest.mark.parametrize(("send", "name", "wanted"), [
    (lambda client: client.run_experiment("dynamics", "runs"), "directory", "runs"),
    (lambda client: client.identify("runs", recordings=["a"]), "recordings", ["a"]),
    (lambda client: client.diagnose("m.json", ["a"], "out", "h"), "holdout", "h"),
    (lambda client: client.track({"kind": "file", "file": "w.csv"}, "m.json", "pid", 1.0, "out"),
     "model", "m.json"),
])
def test_every_goal_of_the_client_is_sent_with_absolute_paths(here, send, name, wanted):
    class Action:
        """Takes the place of an action client; keeps the goal."""

        def server_is_ready(self):
            return True

        def send_goal_async(self, goal, feedback_callback, goal_uuid=None):
            raise SentGoal(getattr(goal, name))

    class Node:
        """Takes the place of the node; has a name."""

        def get_fully_qualified_name(self):
            return "/client"

    client = Client.__new__(Client)  # without a node
    client._wait_s = 0.0
    client.node = Node()
    client._actions = dict.fromkeys(
        ("run_experiment", "identify", "diagnose", "track"), Action())
    with pytest.raises(SentGoal) as sent:
        send(client)
    expected = ([f"{here}/{path}" for path in wanted] if isinstance(wanted, list)
                else f"{here}/{wanted}")
    assert sent.value.args[0] == expected
