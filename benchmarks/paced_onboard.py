# SPDX-License-Identifier: BSD-3-Clause
"""Track with the law on board at the wall clock's pace: python paced_onboard.py [SECONDS].

The stage, the controller that uploads the law, and this client are processes of their own. The
stage counts how late each of its ticks begins and which of them missed their deadline. This client
looks that no sample and no tick of the feedback is missing. With ``--busy N`` so many processes
compute all the while. Beside it stands a bare timer that wakes once a tick at the same priority,
for at most a minute: nothing that has to wake can be more punctual on this machine.
"""

import argparse
import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path

from bare_timer import PRIORITY, bare_timer
from loop_speed import REFERENCE, stand_in_for_recorder
from paced_account import PacedAccount
from piezo_interfaces.msg import AppliedFeedback
from stage_model import write_model

from piezo_bringup.processes import Processes
from piezo_client.client import Client
from piezo_ros.quality import FEEDBACK

SAMPLES_PER_TICK = 40
BARE_TIMER_S = 60.0
SPIN = "while True: pass"


class OnboardRun(PacedAccount):
    """Keeps the account of a run whose feedback the stage evaluates; see `PacedAccount`.

    Of its ticks those are fed back whose feedback was told. For `bare_timer` see the function.
    """

    def __init__(self, client):
        self.fed_back_ticks, self.bare_timer = 0, {}
        super().__init__(client)
        client.node.create_subscription(
            AppliedFeedback, "applied_feedback", self._take_feedback, FEEDBACK)

    def run(self, directory, duration_s):
        """Track for a time (s) of the wall clock; return the error (percent)."""
        result = self._client.track(
            REFERENCE, directory / "model.json", "composite", duration_s, directory)
        self.hear_diagnostics()
        return result.e_rms_percent

    @property
    def counted_ticks(self):
        """Ticks of the loop, at rest too."""
        return sum(self.histogram.values())

    @property
    def histogram(self):
        """Ticks by how late they began, of "within 0.2 ms" to "beyond 100 ms"."""
        return {name.removeprefix("ticks_").replace("_", " "): int(count)
                for name, count in self.described.items() if name.startswith("ticks_")}

    @property
    def missed_percent(self):
        """Of the ticks, those that missed their deadline."""
        return 100.0 * self.missed_deadlines / self.counted_ticks

    @property
    def bare_percent(self):
        """Of the wakes of a bare timer, those later than a tick."""
        return 100.0 * self.bare_timer["late"] / self.bare_timer["wakes"]

    @property
    def missed_deadlines(self):
        """Ticks that began too late for the samples that were due."""
        return int(self.described["missed_deadlines"])

    def account(self, block):
        """Count the ticks of a block."""
        self.ticks += len(block.voltage_v) // SAMPLES_PER_TICK

    def _take_feedback(self, feedback):
        self.fed_back_ticks += len(feedback.voltage_v)


@contextlib.contextmanager
def busy(count):
    """Let so many processes compute."""
    spinning = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(count)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def onboard_run(directory, duration_s, busy_processes=0, priority=PRIORITY):
    """Track on the simulated stage in paced mode; return the `OnboardRun`."""
    directory.mkdir(parents=True, exist_ok=True)
    write_model(directory / "model.json")
    with Processes(directory, data_root=directory) as processes, \
            Client("", "recorder") as client, busy(busy_processes):
        stand_in_for_recorder(client.node)
        processes.start("stage", {"autostart": True, "timing": "paced",
                                  "real_time_priority": priority})
        processes.start("controller", {"feedback": "onboard"})
        run = OnboardRun(client)
        run.run(directory, duration_s)
        processes.stop()
        run.bare_timer = bare_timer(min(duration_s, BARE_TIMER_S), priority)
        return run


def main():
    """Print the account."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seconds", type=float, nargs="?", default=600.0)
    parser.add_argument("--busy", type=int, default=0, help="processes that compute meanwhile")
    parser.add_argument("--priority", type=int, default=PRIORITY,
                        help="of the stage; 0 asks for none")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        run = onboard_run(Path(directory), options.seconds, options.busy, options.priority)
    print(f"{run.ticks} ticks in {options.seconds:g} s beside {options.busy} busy processes; "
          f"samples lost {run.lost_samples}, feedback missed {run.missed_feedback}, "
          f"ticks without feedback {run.ticks - run.fed_back_ticks}")
    print(f"deadlines missed {run.missed_deadlines} of {run.counted_ticks}, "
          f"{run.missed_percent:.4f} %, at most by "
          f"{run.described['longest_wait_of_a_tick_ms']} ms")
    print(f"a bare timer woke late in {run.bare_percent:.4f} %, at most by "
          f"{run.bare_timer['latest_ms']:.3f} ms")
    print(f"priority and memory: {run.described['real_time']}")
    for name, count in run.histogram.items():
        print(f"ticks begun {name:18}{count:>12}")


if __name__ == "__main__":
    main()
