# SPDX-License-Identifier: BSD-3-Clause
"""The suite in one session, in which nodes and operators are killed or stopped in a run."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from piezo_interfaces.msg import Reference, SampleBlock
from piezo_interfaces.srv import StopRecording
from probes import write_endless_probe
from rclpy.serialization import deserialize_message
from stage_model import write_model
from std_srvs.srv import Trigger

from piezo_client.client import Client, GoalFailed
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_ros.quality import SAMPLES

sys.path.append(str(Path(__file__).parents[1] / "test"))
from forked_processes import ForkedProcesses

# Asks for one goal after the other, as any client of ours does; each outcome goes into a file.
OPERATOR = """
import json, sys
from pathlib import Path
from piezo_client.client import Client, GoalFailed
from piezo_interfaces.msg import Reference
with Client(sys.argv[1], "operator") as client:
    for line in sys.stdin:
        outcome, name, fields = json.loads(line)
        if "reference" in fields:
            fields["reference"] = Reference(**fields["reference"])
        try:
            message, success = client.goal(name, **fields).message, True
        except GoalFailed as failure:
            message, success = str(failure), False
        Path(outcome + ".new").write_text(json.dumps([success, message]))
        Path(outcome + ".new").rename(outcome)
"""
REFERENCE = {"kind": "harmonic", "frequency_hz": [10.0], "amplitude_um": [10.0], "centre_um": 30.0}
WORKERS = {"track": "controller", "run_experiment": "identification"}
NODES = ("stage", "recorder", *WORKERS.values())
VICTIMS = ("stage", "recorder", "worker", "operator")
SIGNALS = (signal.SIGKILL, signal.SIGSTOP)
TIMINGS = ("lockstep", "paced")
MODES = ("pi", "feedforward", "composite")
# A late answer is not what this is about.
PATIENT = {"stage": {"max_missed_feedback": 10_000, "lockstep_timeout_s": 60.0,
                     "exchange_timeout_s": 60.0}, "controller": {"max_late_percent": 100.0}}
# What the operator is told, by who went away; the worker's own end cannot come from it.
CAUSES = {
    "recorder": "the recorder {namespace}/recorder is gone",
    "worker": "the node that serves .* has ended",
}
STAGE_CAUSES = {
    "track": "the stage stopped before the end: the stage {namespace}/stage is gone",
    "run_experiment": "the node that serves play_waveform has ended",
}
UNANSWERED = re.compile("did not answer|did not report|gave this request up")
# As much lies in front of the first sample at least: there is nothing to read before.
HEAD_BYTES = 50_000
# What leads to a run, and back to a whole suite: not what this is about either.
PREPARATION_S = 600.0
RESTING_FLAGS = SampleBlock.FLAG_STOPPED


class Late(Exception):
    """Something did not happen in time."""


class Session:
    """All the nodes of a stage, an operator with a process of his own, and who looks after both.

    A context manager that ends them. The model has the size of an identified one. Once somebody is
    gone, a run may take `patience_s` to its end, and took `longest_s` at most. `unanswered` is what
    was said of requests that got no answer.
    """

    def __init__(self, directory, timing, patience_s):
        self.namespace = f"/dies_{timing}"
        self.unanswered, self.longest_s = [], 0.0
        self._directory, self._timing, self._patience_s = directory, timing, patience_s
        self._rounds, self._block = 0, None
        self._model = directory / "model.json"
        write_model(self._model)
        self.processes = ForkedProcesses(directory / "logs", data_root=directory)

    def __enter__(self):
        for name in NODES:
            self._start(name)
        self._client = Client(self.namespace, "overseer")
        self._client.node.create_subscription(
            SampleBlock, "samples", self._receive, SAMPLES, raw=True)
        self._begin_operator()
        self._until("every node is there", self._whole)
        return self

    def __exit__(self, *_):
        self._end_operator()
        self._client.close()
        self.processes.stop()

    def round(self, name, victim, number, mode="pi", after_s=0.0):
        """Let an operator begin a run, take somebody away, and see that the rest gets over it.

        The run is track or run_experiment. `after_s` after its first samples were recorded, one of
        `VICTIMS` gets the signal. What did not happen as it must is returned.
        """
        self._rounds += 1
        before = Path(self._directory, f"{self._rounds}_before")
        after = Path(self._directory, f"{self._rounds}_after")
        faults, marks = [], {node: self._log_size(node) for node in NODES}
        try:
            self._take_away(name, victim, number, mode, after_s, before, faults)
            result = self._client.goal(name, **self._fields(name, after, mode, 0.5))
            if not result.success:
                faults.append(f"the next run failed: {result.message}")
        except (Late, GoalFailed) as failure:
            faults.append(str(failure))
        said = [*faults, *(self._log_since(node, mark) for node, mark in marks.items())]
        self.unanswered += [line for text in said for line in text.splitlines()
                            if UNANSWERED.search(line)]
        faults += [f"{node} logged a traceback" for node, mark in marks.items()
                   if "Traceback" in self._log_since(node, mark)]
        return [f"{self._timing} {name} {mode}, {victim} {signal.Signals(number).name}: {fault}"
                for fault in faults]

    def _take_away(self, name, victim, number, mode, after_s, directory, faults):
        worker = WORKERS[name]
        outcome = Path(f"{directory}.json")
        directory.mkdir()
        write_endless_probe(directory)
        self._block = None
        self._operator.stdin.write(json.dumps([str(outcome), name, self._fields(
            name, directory, mode, 3600.0)]) + "\n")
        self._operator.stdin.flush()
        begun_s = time.monotonic()
        while not (outcome.exists() or holds_samples(directory)):
            if time.monotonic() - begun_s > PREPARATION_S:
                raise Late(f"not within {PREPARATION_S:g} s: the run began")
            # What comes meanwhile is read, too: a reader that hangs holds the stage back.
            self._client.spin_until(outcome.exists, 0.5)
        if outcome.exists():
            raise Late(f"the run did not begin: {outcome.read_text()}")
        self._client.spin_until(lambda: False, after_s)
        node = worker if victim == "worker" else victim
        process = self._operator if victim == "operator" else self.processes.process(node)
        mark = self._log_size(worker)
        process.send_signal(number)
        begun_s = time.monotonic()
        try:
            self._expect_end(name, victim, outcome, mark, faults)
            self.longest_s = max(self.longest_s, time.monotonic() - begun_s)
        finally:
            if number == signal.SIGSTOP:
                process.send_signal(signal.SIGCONT)
            if victim == "operator":
                self._end_operator()
                self._begin_operator()
            else:
                self._until(f"{node} ended", lambda: process.poll() is not None)
                self._start(node)
        if victim in ("worker", "operator"):
            self._until("the recording was closed", self._nothing_is_recorded)
        faults += self._unreadable(directory, victim)
        self._until("every node was there again", self._whole)
        self._until("the stage was reset",
                    lambda: self._client.call(Trigger, "reset").success)

    def _expect_end(self, name, victim, outcome, mark, faults):
        if victim == "operator":
            told = f"the client {self.namespace}/operator is gone"
            self._until("the worker missed the operator",
                        lambda: told in self._log_since(WORKERS[name], mark), self._patience_s)
        else:
            self._until("the operator was told", outcome.exists, self._patience_s)
            success, message = json.loads(outcome.read_text())
            cause = (STAGE_CAUSES[name] if victim == "stage" else CAUSES[victim]).format(
                namespace=self.namespace)
            if success or not re.search(cause, message):
                faults.append(f"the operator was told: {message!r}")
        if victim != "stage":
            self._until("the stage was at rest", self._at_rest, self._patience_s)

    def _fields(self, name, directory, mode, duration_s):
        if name == "run_experiment":  # whose length the directory tells
            return {"experiment": "dynamics", "directory": str(directory)}
        reference = REFERENCE if duration_s > 1.0 else Reference(**REFERENCE)
        return {"reference": reference, "model": str(self._model), "mode": mode,
                "duration_s": duration_s, "directory": str(directory)}

    def _start(self, name):
        parameters = dict(PATIENT.get(name, {}))
        if name == "stage":
            parameters |= {"timing": self._timing, "autostart": True}
        self.processes.start(name, parameters, self.namespace)

    def _begin_operator(self):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
        self._operator = subprocess.Popen(
            [sys.executable, "-c", OPERATOR, self.namespace], env=environment, text=True,
            stdin=subprocess.PIPE)

    def _end_operator(self):
        self._operator.kill()
        self._operator.wait()
        self._operator.stdin.close()

    def _until(self, what, condition, patience_s=PREPARATION_S):
        if not self._client.spin_until(condition, patience_s):
            raise Late(f"not within {patience_s:g} s: {what}")

    def _whole(self):
        found = self._client.node.get_node_names_and_namespaces()
        return {(name, self.namespace) for name in NODES} <= set(found)

    def _receive(self, raw):
        self._block = raw

    def _at_rest(self):
        if self._block is None:
            return False
        block = deserialize_message(self._block, SampleBlock)
        return not block.flags & ~RESTING_FLAGS and block.voltage_v[-1] == 0.0

    def _nothing_is_recorded(self):
        self._client.spin_until(lambda: False, 0.2)  # the recorder has other work, too
        message = self._client.call(StopRecording, "recorder/stop_recording").message
        return message.startswith(("Nothing is being", "The recording was closed early"))

    def _unreadable(self, directory, victim):
        """Say what is wrong with the recording of a run that ended early."""
        try:
            path, = filter(Path.is_dir, directory.iterdir())
            recording = read_recording(path)
        except (RecordingError, ValueError, OSError) as error:
            return [f"its recording: {error}"]
        if recording.gaps and victim != "recorder":  # which loses samples while it is stopped
            return [f"its recording has gaps: {recording.gaps}"]
        if victim in ("worker", "operator") and recording.voltage_v[-1] != 0.0:
            return [f"its recording ends at {recording.voltage_v[-1]:g} V"]
        return []

    def _log_size(self, name):
        return self.processes.log(name).stat().st_size

    def _log_since(self, name, mark):
        return self.processes.log(name).read_bytes()[mark:].decode(errors="replace")


def holds_samples(directory):
    """Whether samples of the only recording of a directory are on the disk already."""
    if not any(path.stat().st_size > HEAD_BYTES for path in directory.glob("*/*.mcap")):
        return False
    try:
        path, = filter(Path.is_dir, directory.iterdir())
        return len(read_recording(path).voltage_v) > 0
    except RecordingError:  # nothing but its head
        return False
