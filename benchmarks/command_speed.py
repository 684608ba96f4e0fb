# SPDX-License-Identifier: BSD-3-Clause
"""How long commands take to answer what costs no work, and the suite to make its first recording.

The answers are help, a refusal, or that a stage is missing.
"""

import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

RUN = Path(__file__).parents[1] / "run"
ASKED = {
    "answer, list of executables": (),
    "answer, identify --help": ("piezo_identification", "identify", "--help"),
    "answer, diagnose of a path that is missing": (
        "piezo_identification", "diagnose", "--model", "none", "--data", "none", "--output",
        "none"),
    "answer, design with an option that is mistyped": ("piezo_controller", "design", "--modle"),
    "answer, stage --help": ("piezo_client", "stage", "--help"),
    "answer, stage status where nobody serves": ("piezo_client", "stage", "status"),
    "answer, stage_sim --help": ("piezo_sim", "stage_sim", "--help"),
}
SUITE_START = "start of the suite to the first recording"
TARGETS = {name: {"at_most": 4.0 if "nobody" in name else 1.0} for name in ASKED} | {
    SUITE_START: {"at_most": 8.0}}
"""Seconds; a stage is looked for during three of them."""

LONGEST_S = 120.0
END_S = 30.0
WAVEFORM = "time_s,voltage_v\n" + "".join(
    f"{0.001 * n:.3f},{50.0 * n / 100.0:.2f}\n" for n in range(100))


def answer_times_s():
    """Return the seconds that each of `ASKED` takes, as a user waits for it, by name."""
    times = {}
    for name, arguments in ASKED.items():
        begin_s = time.perf_counter()
        subprocess.run([RUN, *arguments], env=_environment(), capture_output=True, check=False)
        times[name] = time.perf_counter() - begin_s
    return times


def first_recording_s() -> float:
    """Return the seconds from the start of the suite until a waveform was played and recorded.

    RuntimeError is raised if none could be recorded in two minutes; it ends with what the client
    said.
    """
    environment = _environment()
    with tempfile.TemporaryDirectory() as directory:
        (Path(directory) / "waveform.csv").write_text(WAVEFORM)

        def begin(*arguments: str) -> subprocess.Popen[str]:
            return subprocess.Popen([RUN, *arguments], env=environment, cwd=directory, text=True,
                                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT)

        begin_s = time.perf_counter()
        suite = begin("piezo_bringup", "suite", "--data-root", directory, "--logs", directory)
        try:
            while True:
                play = begin("piezo_client", "stage", "play", "waveform.csv", "--output", "runs")
                said = play.communicate(timeout=LONGEST_S)[0]
                passed_s = time.perf_counter() - begin_s
                if play.returncode == 0:
                    return passed_s
                if passed_s > LONGEST_S:
                    raise RuntimeError(f"nothing was recorded in {passed_s:.0f} s: {said}")
        finally:
            suite.send_signal(signal.SIGINT)
            suite.communicate(timeout=END_S)


def _environment() -> dict[str, str]:
    """Return the environment without what is of this process alone."""
    return {name: value for name, value in os.environ.items()
            if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
