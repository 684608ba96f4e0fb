# SPDX-License-Identifier: BSD-3-Clause
"""How long after the start of the suite a first recording is on disk, as a user waits for it."""

import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

RUN = Path(__file__).parents[1] / "run"
TITLE = "start of the suite to the first recording"
TARGETS = {TITLE: {"at_most": 8.0}}
LONGEST_S = 120.0
END_S = 30.0
WAVEFORM = "time_s,voltage_v\n" + "".join(
    f"{0.001 * n:.3f},{50.0 * n / 100.0:.2f}\n" for n in range(100))


def first_recording_s() -> float:
    """Return the seconds from the start of the suite until a waveform was played and recorded.

    RuntimeError is raised if none could be recorded in two minutes; it ends with what the client
    said.
    """
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
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
