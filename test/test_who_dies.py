# SPDX-License-Identifier: BSD-3-Clause
"""Whoever is killed or hangs in a run, the rest ends it in order, and the next run works."""

import functools
import json
import os
import re
import signal
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from piezo_interfaces.msg import Reference, SampleBlock
from piezo_interfaces.srv import StopRecording

from piezo_client.client import ServiceFailed
from piezo_identification.experiments.probing import probe_file
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError

# Asks for one goal as any client of ours does, and leaves what became of it in a file.
OPERATOR = """
import json, sys
from pathlib import Path
from piezo_client.client import Client, GoalFailed
from piezo_interfaces.msg import Reference
namespace, outcome, name, fields = sys.argv[1:]
fields = json.loads(fields)
if "reference" in fields:
    fields["reference"] = Reference(**fields["reference"])
with Client(namespace, "operator") as client:
    try:
        message = client.goal(name, **fields).message
        success = True
    except GoalFailed as failure:
        success, message = False, str(failure)
Path(outcome + ".new").write_text(json.dumps([success, message]))
Path(outcome + ".new").rename(outcome)
"""
REFERENCE = {"kind": "harmonic", "frequency_hz": [10.0], "amplitude_um": [10.0], "centre_um": 30.0}
WORKERS = {"track": "controller", "run_experiment": "identification"}
TIMINGS = ("lockstep", "paced")
# A late answer is not what these tests are about.
PATIENT = {"max_missed_feedback": 10_000}
PATIENT_NODES = {"controller": {"max_late_percent": 100.0}}

# What the operator is told, by who went away; the worker's own end cannot come from it.
CAUSES = {
    "recorder": "the recorder {namespace}/recorder is gone",
    "worker": "the node that serves .* has ended",
}
STAGE_CAUSES = {
    "track": "the stage stopped before the end: the stage {namespace}/stage is gone",
    "run_experiment": "the node that serves play_waveform has ended",
}
# As much lies in front of the first sample at least: there is nothing to read before.
HEAD_BYTES = 50_000
VICTIMS = ("stage", "recorder", "worker", "operator")
CASES = list(product(TIMINGS, WORKERS, VICTIMS, (signal.SIGKILL, signal.SIGSTOP)))
# The rest differ from these in what they have in common with another one; where the time comes
# from is of no matter to who notices that somebody is gone, and lockstep waits for nothing.
MOST_IMPORTANT = {
    ("lockstep", "track", "recorder", signal.SIGKILL),
    ("lockstep", "track", "worker", signal.SIGKILL),
    ("lockstep", "track", "operator", signal.SIGKILL),
    ("lockstep", "run_experiment", "stage", signal.SIGKILL),
    ("lockstep", "run_experiment", "recorder", signal.SIGSTOP),
}
if not os.environ.get("LONG_TESTS"):
    CASES = [case for case in CASES if case in MOST_IMPORTANT]


@pytest.fixture(scope="module")
def model_file(plain_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, IdentifiedModel(plain_model, (-20.0, 120.0)))
    return path


class Suite:
    """All the nodes of a stage, and an operator who works with them from a process of his own."""

    def __init__(self, client, timing, model_file):
        self.client, self.processes, self.timing = client, client.processes, timing
        self.namespace = client.node.get_namespace()
        self._model_file = model_file

    def fields(self, name, directory, duration_s=3600.0):
        if name == "run_experiment":  # whose length the directory tells
            return {"experiment": "dynamics", "directory": str(directory)}
        return {"reference": REFERENCE, "model": str(self._model_file), "mode": "pi",
                "duration_s": duration_s, "directory": str(directory)}

    def begin(self, name, directory, outcome, **options):
        """Let an operator ask for a goal; return his process once the stage moves."""
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
        self.client.forget()
        operator = subprocess.Popen(
            [sys.executable, "-c", OPERATOR, self.namespace, str(outcome), name,
             json.dumps({**self.fields(name, directory), **options})], env=environment)
        moves = SampleBlock.FLAG_PLAYING | SampleBlock.FLAG_TRACKING
        # A paced stage has sent thousands of blocks until then: only the last one is looked at.
        self.client.until(lambda: operator.poll() is not None or (
            self.client.blocks and self.client.blocks[-1].flags & moves))
        assert operator.poll() is None, f"the operator ended with {operator.returncode}"
        self.client.forget()
        return operator

    def process(self, victim, operator, name):
        if victim == "operator":
            return operator
        return self.processes.process(self.node(victim, name))

    @staticmethod
    def node(victim, name):
        return WORKERS[name] if victim == "worker" else victim

    def revive(self, process, number, victim, name):
        """Let a process that hung go on, and end by itself; start anew what is a node."""
        if number == signal.SIGSTOP:
            process.send_signal(signal.SIGCONT)
        self.client.until(lambda: process.poll() is not None)
        if victim != "operator":
            self.processes.start(self.node(victim, name), {
                "stage": {"timing": self.timing, "autostart": True, **PATIENT},
                **PATIENT_NODES}.get(self.node(victim, name)), self.namespace)

    def wait_until_whole(self):
        """Wait until every node is there."""
        self.client.until(lambda: {"stage", "recorder", *WORKERS.values()}
                          <= self.client.node_names())

    def run(self, name, directory):
        """Run one short goal to its end, as another client."""
        fields = self.fields(name, directory, 0.1)
        if "reference" in fields:
            fields["reference"] = Reference(**REFERENCE)
        return self.client.goal(name, **fields)


@pytest.fixture(scope="module")
def suite_of(nodes, model_file):
    """Returns the suite of a timing, which is started once."""
    @functools.cache
    def suite_of(timing):
        client = nodes.start("recorder", "identification", "controller",
                             namespace=f"/dies_{timing}", timing=timing,
                             node_parameters=PATIENT_NODES, **PATIENT)
        return Suite(client, timing, model_file)

    return suite_of


def recorded(directory):
    """The only recording of a directory."""
    path, = filter(Path.is_dir, directory.iterdir())
    return read_recording(path)


def holds_samples(directory):
    """Whether samples of the only recording of a directory are on the disk already."""
    if not any(path.stat().st_size > HEAD_BYTES for path in directory.glob("*/*.mcap")):
        return False
    try:
        return len(recorded(directory).voltage_v) > 0
    except RecordingError:  # nothing but its head
        return False


def nothing_is_recorded(client):
    """Tell whether nothing is; the answer to a client that was just met may get lost."""
    try:
        message = client.call(StopRecording, "recorder/stop_recording").message
    except ServiceFailed:
        return False
    return message.startswith(("Nothing is being", "The recording was closed early"))


@pytest.mark.parametrize(("timing", "name", "victim", "number"), CASES)
def test_whoever_goes_away_the_rest_ends_in_order(
        suite_of, endless, tmp_path, timing, name, victim, number):
    whole = suite_of(timing)
    (tmp_path / "first").mkdir()
    (endless / probe_file.NAME).rename(tmp_path / "first" / probe_file.NAME)
    client, outcome = whole.client, tmp_path / "outcome.json"
    operator = whole.begin(name, tmp_path / "first", outcome)
    client.until(lambda: holds_samples(tmp_path / "first"))
    process = whole.process(victim, operator, name)
    process.send_signal(number)
    try:
        if victim != "operator":
            client.until(outcome.exists)
            success, message = json.loads(outcome.read_text())
            assert not success
            cause = STAGE_CAUSES[name] if victim == "stage" else CAUSES[victim]
            assert re.search(cause.format(namespace=whole.namespace), message)
        else:
            client.until(lambda: f"the client {whole.namespace}/operator is gone"
                         in whole.processes.log(WORKERS[name]).read_text())
        if victim != "stage":
            assert client.samples().voltage_v[-1] == 0.0
    finally:
        whole.revive(process, number, victim, name)
        operator.kill()
        operator.wait()
    if victim in ("worker", "operator"):
        client.until(lambda: nothing_is_recorded(client))
        assert recorded(tmp_path / "first").voltage_v[-1] == 0.0
    assert len(recorded(tmp_path / "first").voltage_v) > 0

    whole.wait_until_whole()
    client.until(lambda: client.trigger("reset").success)
    # A stage that has only just met a new recorder may have sent a short run before.
    client.connect_recorder(tmp_path / "met")
    assert whole.run(name, tmp_path / "next").success
