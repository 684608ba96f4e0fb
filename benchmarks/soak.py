# SPDX-License-Identifier: BSD-3-Clause
"""Run random goals and faults for long: python soak.py [--seconds S] [--seed N].

Lockstep tracking and experiments, each recorded, into which faults break: emergency stops,
cancellations, lost sensors, killed clients and recorders, restarts. After each the stage must be
at rest and every recorded sample accounted for. The status is 1 where one is not.
"""

import argparse
import os
import random
import shutil
import signal
import sys
import time
from collections import Counter
from contextlib import suppress
from importlib import resources
from pathlib import Path

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from piezo_interfaces.msg import Reference, SampleBlock
from stage_model import write_model
from std_srvs.srv import Trigger

from piezo_bringup.processes import Processes, clean_shared_memory
from piezo_client.client import Client, GoalFailed
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_ros.quality import SAMPLES

OUTPUT = Path(__file__).parents[1] / "runs" / "soak"
EXPERIMENTS = ("dynamics", "multisine", "validation")
MODES = ("feedforward", "composite")
SENSOR_FAULTS = {"silent_sensor": {}, "stuck_sensor": {}, "off_scale_sensor": {"reading_um": 150.0},
                 "noisy_sensor": {"noise_rms_um": 2.0}}
# Of stage time: how far the faults of a sensor lie apart, and for how long there are some.
FAULT_DISTANCE_S, FAULTS_UNTIL_S = 20.0, 2000.0
FAULT_S = 0.05
NODES = ("stage", "recorder", "identification", "controller")
ANSWER_TIMEOUT_S = 120.0
RESULT_REQUESTS = 6
REPORT_PERIOD_S = 30.0


def plant_with_faults(path, draw):
    """Write the default plant whose sensor fails now and then."""
    content = yaml.safe_load((resources.files("piezo_sim") / "plant.yaml").read_text())

    def told(value, unit):
        return {"value": value, "unit": unit, "source": "drawn for the soak"}

    begin_s = draw.uniform(1.0, FAULT_DISTANCE_S)
    while begin_s < FAULTS_UNTIL_S:
        name = draw.choice(sorted(SENSOR_FAULTS))
        content["sensor"].append({
            "effect": name, "begin_s": told(begin_s, "s"), "end_s": told(begin_s + FAULT_S, "s"),
            **{key: told(value, "um") for key, value in SENSOR_FAULTS[name].items()}})
        begin_s += draw.uniform(0.5, 1.5) * FAULT_DISTANCE_S
    path.write_text(yaml.safe_dump(content))
    return path


class Soak:
    """The suite, and the account of what befell it.

    Parameters
    ----------
    directory : pathlib.Path
    seed : int
    """

    def __init__(self, directory, seed):
        self.draw = random.Random(seed)
        self.directory = directory
        self.actions, self.trips, self.disturbed = Counter(), Counter(), Counter()
        self.samples = self.killed_recordings = 0
        self.losses = []
        self.memory_mb = {}
        self._at_rest = True
        self._number = 0
        self.processes = Processes(directory / "logs", data_root=directory)
        write_model(directory / "model.json")

    def __enter__(self):
        for name in NODES:
            self.start(name)
        self.client = Client(name="soak")
        self.client.node.create_subscription(SampleBlock, "samples", self._on_samples, SAMPLES)
        self.client.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._cause = ""
        self.client.spin_until(self._complete, ANSWER_TIMEOUT_S)
        return self

    def __exit__(self, *_):
        self.client.__exit__()
        self.processes.stop()

    def start(self, name):
        """Start a node, or start it anew."""
        parameters = {}
        if name == "stage":
            plant = plant_with_faults(self.directory / "plant.yaml", self.draw)
            parameters = {"autostart": True, "timing": "lockstep", "plant": plant,
                          "seed": self.draw.randrange(1000)}
        self.processes.start(name, parameters)

    def _complete(self):
        return set(NODES) <= set(self.client.node.get_node_names())

    def _on_samples(self, block):
        self._at_rest = not block.flags & ~SampleBlock.FLAG_STOPPED and block.voltage_v[-1] == 0.0

    def _on_diagnostics(self, message):
        for status in message.status:
            if status.name == "/stage: stage":
                cause = status.message if status.level == b"\x02" else ""
                if cause and cause != self._cause:
                    self.trips[cause.split(":")[0].rstrip(" 0123456789.-")[:60]] += 1
                self._cause = cause

    # What is done

    def act(self):
        """Do one thing, with or without a disturbance; account for its recording."""
        self._number += 1
        directory = self.directory / "recordings" / str(self._number)
        disturbance = self.draw.choice([None, None, *DISTURBANCES])
        name, fields = self._goal(directory)
        self.actions[name] += 1
        try:
            goal = self.client.send(name, **fields)
        except GoalFailed as failure:
            self.losses.append(f"{self._number}: {failure}")
            return
        outcome = goal.get_result_async()
        ended = self.client.spin_until(outcome.done, self.draw.uniform(0.0, 3.0))
        if disturbance and not ended:
            self.disturbed[disturbance] += 1
            DISTURBANCES[disturbance](self, name)
        # The client of a node that was killed waits in vain.
        gone = disturbance == "kill client" and not ended
        if not gone and not self._ends(goal, outcome):
            self.losses.append(f"{self._number}: {name} ({disturbance}) never ended")
        self._mend()
        self._account(directory, disturbance)
        shutil.rmtree(directory, ignore_errors=True)

    def _goal(self, directory):
        if self.draw.random() < 0.5:
            return "run_experiment", {"experiment": self.draw.choice(EXPERIMENTS),
                                      "directory": str(directory)}
        reference = Reference(
            kind="harmonic", frequency_hz=[float(self.draw.choice([5, 20, 40, 100]))],
            amplitude_um=[self.draw.uniform(5.0, 40.0)], phase_rad=[0.0], centre_um=40.0)
        return "track", {
            "reference": reference, "model": str(self.directory / "model.json"),
            "mode": self.draw.choice(MODES), "duration_s": self.draw.uniform(0.5, 3.0),
            "directory": str(directory)}

    def emergency_stop(self, _):
        """Press the button."""
        self.client.call(Trigger, "emergency_stop")

    def restart_stage(self, _):
        """End the stage in order, and start it anew."""
        process = self.processes.process("stage")
        process.send_signal(signal.SIGTERM)
        self.client.spin_until(lambda: process.poll() is not None, ANSWER_TIMEOUT_S)
        self.start("stage")

    def deactivate(self, _):
        """Deactivate the stage and activate it again."""
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            self.client.call(ChangeState, "stage/change_state",
                             transition=Transition(id=transition))

    def kill_client(self, name):
        """Kill the node that works for the goal."""
        self._kill("controller" if name == "track" else "identification")

    def kill_recorder(self, _):
        """Kill the recorder."""
        self._kill("recorder")

    def _kill(self, name):
        process = self.processes.process(name)
        process.send_signal(signal.SIGKILL)
        self.client.spin_until(lambda: process.poll() is not None, ANSWER_TIMEOUT_S)
        self.start(name)

    def _ends(self, goal, outcome):
        """Wait for a result; ask again where the response may have been lost."""
        for _ in range(RESULT_REQUESTS):
            if self.client.spin_until(outcome.done, ANSWER_TIMEOUT_S / RESULT_REQUESTS):
                return True
            outcome = goal.get_result_async()
        return False

    # What must hold afterwards

    def _mend(self):
        """Wait until the stage is at rest and takes commands again, and every node is there."""
        deadline = time.monotonic() + ANSWER_TIMEOUT_S
        while time.monotonic() < deadline:
            self.client.spin_until(self._complete, ANSWER_TIMEOUT_S)
            if self.client.call(Trigger, "reset").success:
                with suppress(GoalFailed):
                    self.client.goal("play_waveform", voltage_v=[0.0], sample_period_s=25e-6,
                                     repeats=1)
                    if not self.client.spin_until(lambda: self._at_rest, ANSWER_TIMEOUT_S):
                        self.losses.append(f"{self._number}: the stage is not at rest")
                    return
            self.client.spin_until(lambda: False, 0.2)
        self.losses.append(f"{self._number}: the stage takes no commands")

    def _account(self, directory, disturbance):
        for path in directory.glob("*"):
            self._wait_until_closed(path)
            try:
                recording = read_recording(path)
            except RecordingError as error:
                # Of a recorder that was killed, or had nothing to record, before the first samples.
                if "no samples" not in str(error) and "no topic" not in str(error):
                    self.losses.append(f"{self._number}: {error}")
                continue
            self.samples += len(recording.voltage_v)
            self.killed_recordings += not recording.complete
            problems = [f"{count} samples missing from {first}"
                        for first, count in recording.gaps]
            if not recording.complete and disturbance != "kill recorder":
                problems.append("not closed")
            if recording.complete and recording.voltage_v[-1] != 0.0:
                problems.append(f"ends at {recording.voltage_v[-1]:g} V")
            self.losses += [f"{self._number} ({disturbance}): {problem}" for problem in problems]

    def _wait_until_closed(self, path):
        """Wait until the recorder has closed what a killed client began."""
        file = path / f"{path.name}_0.mcap"
        self.client.spin_until(
            lambda: not file.exists() or file.read_bytes().endswith(b"\x89MCAP0\r\n"), 10.0)

    def measure_memory(self):
        """Note the resident memory (MB) of every node: the first, the last and the largest."""
        for name in NODES:
            process = self.processes.process(name)
            with suppress(OSError):
                text = Path(f"/proc/{process.pid}/status").read_text()
                rss_mb = next((int(line.split()[1]) / 1024 for line in text.splitlines()
                               if line.startswith("VmRSS")), 0.0)
                first, _, largest = self.memory_mb.get(name, (rss_mb, rss_mb, rss_mb))
                self.memory_mb[name] = (first, rss_mb, max(rss_mb, largest))

    def report(self):
        """Return what happened, in lines."""
        return [
            f"done {dict(self.actions)}", f"disturbed {dict(self.disturbed)}",
            f"trips {sum(self.trips.values())} {dict(self.trips)}",
            f"samples accounted for {self.samples}, recordings of killed recorders "
            f"{self.killed_recordings}",
            "memory, MB at first, at last, at most: " + ", ".join(
                f"{name} {first:.0f} {last:.0f} {most:.0f}"
                for name, (first, last, most) in self.memory_mb.items()),
            f"losses {len(self.losses)}", *self.losses]


DISTURBANCES = {
    "emergency stop": Soak.emergency_stop,
    "restart stage": Soak.restart_stage,
    "deactivate": Soak.deactivate,
    "kill client": Soak.kill_client,
    "kill recorder": Soak.kill_recorder,
}


def main():
    """Run the soak; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600.0, help="of wall time")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(random.Random().randint(1, 100))
    clean_shared_memory()
    shutil.rmtree(OUTPUT, ignore_errors=True)
    OUTPUT.mkdir(parents=True)
    begun_s = reported_s = time.monotonic()
    with Soak(OUTPUT, options.seed) as soak:
        while time.monotonic() - begun_s < options.seconds:
            soak.act()
            soak.measure_memory()
            if time.monotonic() - reported_s > REPORT_PERIOD_S:
                reported_s = time.monotonic()
                print(f"{reported_s - begun_s:.0f} s: {sum(soak.actions.values())} done, "
                      f"{sum(soak.trips.values())} trips, {len(soak.losses)} losses", flush=True)
    tracebacks = [path.name for path in (OUTPUT / "logs").glob("*.log")
                  if "Traceback" in path.read_text()]
    soak.losses += [f"traceback in {OUTPUT / 'logs' / name}" for name in tracebacks]
    print("\n".join(soak.report()))
    return 1 if soak.losses else 0


if __name__ == "__main__":
    sys.exit(main())
