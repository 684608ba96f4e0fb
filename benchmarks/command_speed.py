# SPDX-License-Identifier: BSD-3-Clause
"""How long commands take to say what costs no work: help, a refusal, that a stage is missing."""

import os
import subprocess
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
TARGETS = {name: {"at_most": 4.0 if "nobody" in name else 1.0} for name in ASKED}
"""Seconds; a stage is looked for during three of them."""


def answer_times_s():
    """Return the seconds that each of `ASKED` takes, as a user waits for it, by name."""
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    times = {}
    for name, arguments in ASKED.items():
        begin_s = time.perf_counter()
        subprocess.run([RUN, *arguments], env=environment, capture_output=True, check=False)
        times[name] = time.perf_counter() - begin_s
    return times
