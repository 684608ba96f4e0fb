# SPDX-License-Identifier: BSD-3-Clause
"""What `suite` refuses before it starts anything, and what it says of the nodes."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from piezo_bringup import suite_command
from piezo_bringup.suite_command import BAD_INPUT, main

SLEEPER = "import signal; signal.pause()"


@pytest.mark.parametrize(("arguments", "said"), [
    (["--data-root", "none"], "none is no folder"),
    (["--parameters", "none.yaml"], "none.yaml is no file"),
])
def test_what_is_not_there_is_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == BAD_INPUT
    printed = capsys.readouterr().err
    assert said in printed
    assert printed.count("\n") == 1
    assert not [*tmp_path.iterdir()]


@pytest.fixture
def slow_nodes(monkeypatch):
    """Processes in place of the nodes, which answer at the second look."""
    silent = iter([{"stage"}, set()])

    class Nodes:
        def __init__(self, names, namespace):
            assert names == ["stage", "recorder"]

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def look(self, timeout_s):
            return next(silent)

    monkeypatch.setitem(sys.modules, "piezo_bringup.readiness", SimpleNamespace(Readiness=Nodes))
    monkeypatch.setattr(suite_command.Processes, "_launch", lambda self, name, command:
                        subprocess.Popen([sys.executable, "-c", SLEEPER]))


def test_suite_says_when_it_is_ready_what_follows_and_how_it_ends(
        tmp_path, monkeypatch, capsys, slow_nodes):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(suite_command.time, "sleep",
                        lambda _: os.kill(os.getpid(), signal.SIGTERM))
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert main(["--nodes", "stage", "recorder", "--namespace", "/left"]) == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    started, ready, following, *ending = capsys.readouterr().out.splitlines()
    assert started.startswith("stage, recorder started")
    assert ready.startswith("ready: every node answers")
    assert following == "next: ./run piezo_client stage --namespace /left status"
    assert ending == ["ending recorder", "ending stage", "all nodes have ended"]
