# SPDX-License-Identifier: BSD-3-Clause
"""Time the closed loop: simulated seconds per second, and the round trip of a tick."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from piezo_interfaces.srv import StartRecording, StopRecording
from rclpy.time import Time
from stage_model import SAMPLE_RATE_HZ, write_model

from piezo_bringup.processes import Processes
from piezo_client.client import Client

REFERENCE = {"kind": "harmonic", "frequency_hz": [40.0], "amplitude_um": [40.0],
             "phase_rad": [0.0], "centre_um": 40.0}
LOCKSTEP = {"autostart": True, "timing": "lockstep"}
WARM_UP_ROUND_TRIPS = 500
PING_PONG_TIMEOUT_S = 120.0


class BenchmarkProcesses(Processes):
    """Starts the node modules of this directory as well."""

    def start_module(self, name, parameters=None):
        """Start a module of this directory, such as ``ping_node``, with ROS parameters."""
        module = Path(__file__).with_name(f"{name}.py")
        command = [sys.executable, str(module), "--ros-args"]
        for key, value in (parameters or {}).items():
            text = str(value).lower() if isinstance(value, bool) else value
            command += ["-p", f"{key}:={text}"]
        with open(self.log(name), "a", encoding="utf-8") as log:
            self._running[name] = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env=self._environment, start_new_session=True)


def closed_loop(directory, simulated_s, executables):
    """Return the simulated seconds per second of the loop in lockstep.

    The processes of the loop are given with their parameters. The time is from the stage's first
    diagnostics message while it tracks to the last; ValueError is raised if it tracked for too
    short a time to tell.
    """
    progress = _track(directory, simulated_s, executables)
    if len(progress) < 2:
        raise ValueError(f"the stage tells once a second where it is, and {simulated_s:g} s of its "
                         "own were over before it had told twice: track for longer")
    (begin_s, begin_sample), *_, (end_s, end_sample) = progress
    return (end_sample - begin_sample) / SAMPLE_RATE_HZ / (end_s - begin_s)


def tick_round_trips(directory, duration_s):
    """Round trips (s) of the loop over the model at the pace of the wall clock.

    Each takes from the measurement of a tick's samples until the stage has the answer.
    """
    file = directory / "tick.npy"
    # However late an answer is, it shall be timed.
    paced = {"autostart": True, "max_missed_feedback": 10000, "round_trips_file": file}
    answering = {"feedback": "remote", "max_late_percent": 100.0}
    _track(directory, duration_s, {"controller": answering}, paced)
    return np.load(file)[WARM_UP_ROUND_TRIPS:]


def ping_pong_round_trips(directory, count):
    """Round trips (s) of the same messages, as often, between nodes that do nothing else."""
    directory.mkdir(parents=True, exist_ok=True)
    file = directory / "ping.npy"
    with BenchmarkProcesses(directory, data_root=directory) as processes:
        processes.start_module("pong_node")
        processes.start_module("ping_node", {"round_trips_file": file, "count": count})
        processes.process("ping_node").wait(PING_PONG_TIMEOUT_S)
    return np.load(file)[WARM_UP_ROUND_TRIPS:]


def _track(directory, duration_s, executables, stage=None):
    """Track in composite mode; return the progress, see `_watch_progress`.

    With parameters for it, the stage over the model is started as well.
    """
    directory.mkdir(parents=True, exist_ok=True)
    write_model(directory / "model.json")
    with BenchmarkProcesses(directory, data_root=directory) as processes, \
            Client("", "client" if "recorder" in executables else "recorder") as client:
        if "recorder" not in executables:
            stand_in_for_recorder(client.node)
        progress = _watch_progress(client.node)
        for name, parameters in executables.items():
            processes.start(name, parameters)
        if stage is not None:
            processes.start_module("model_stage_node", stage)
        client.track(REFERENCE, directory / "model.json", "composite", duration_s, directory)
    return progress


def stand_in_for_recorder(node):
    """Agree to every recording and record nothing: the controller asks for one."""
    def agree(request, response):
        response.success = True
        return response

    node.create_service(StartRecording, "recorder/start_recording", agree)
    node.create_service(StopRecording, "recorder/stop_recording", agree)


def _watch_progress(node):
    """Collect (time in s, next sample) from the stage's diagnostics while it tracks."""
    progress = []

    def on_diagnostics(message):
        for status in message.status:
            if status.message == "track":
                values = {value.key: value.value for value in status.values}
                time_s = Time.from_msg(message.header.stamp).nanoseconds * 1e-9
                progress.append((time_s, int(values["next_sample"])))

    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    return progress
