# SPDX-License-Identifier: BSD-3-Clause
"""Record for long at the full sample clock, in simulated time: python recording.py [SECONDS].

Accounts for every sample, and tells the recorder's memory on the way.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from piezo_interfaces.srv import StartRecording, StopRecording

from piezo_bringup.processes import Processes
from piezo_client.client import Client

SAMPLE_RATE_HZ = 40_000
PERIOD_V = 50.0 - 50.0 * np.cos(2 * np.pi * np.arange(4000) / 4000)
MEMORY_EVERY_S = 10.0


def resident_mb(process):
    """Memory of a process (MB)."""
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def record(directory, duration_s):
    """Record a waveform; return the recorder's response and its memory on the way."""
    with Processes(directory / "logs", data_root=directory) as processes, Client() as client:
        processes.start("stage", {"autostart": True, "timing": "lockstep"})
        processes.start("recorder")
        client.spin_until(lambda: {"stage", "recorder"} <= set(client.node.get_node_names()), 60.0)
        # The recorder connects with the first samples.
        client.goal("play_waveform", voltage_v=[0.0], sample_period_s=25e-6, repeats=1)
        started = client.call(StartRecording, "recorder/start_recording",
                              directory=str(directory), name="long")
        if not started.success:
            raise RuntimeError(started.message)
        goal = client.send("play_waveform", voltage_v=PERIOD_V.tolist(), sample_period_s=25e-6,
                           repeats=round(duration_s * SAMPLE_RATE_HZ / len(PERIOD_V)))
        outcome, memory_mb = goal.get_result_async(), []
        while not client.spin_until(outcome.done, MEMORY_EVERY_S):
            memory_mb.append(resident_mb(processes.process("recorder")))
        return client.call(StopRecording, "recorder/stop_recording",
                           last_sample=outcome.result().result.last_sample), memory_mb


def main():
    """Print the account."""
    duration_s = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    with tempfile.TemporaryDirectory() as directory:
        stopped, memory_mb = record(Path(directory), duration_s)
        size_mb = sum(path.stat().st_size for path in Path(stopped.path).iterdir()) / 1e6
    print(f"{stopped.samples} samples recorded, {stopped.missing_samples} missing "
          f"{stopped.message}; {size_mb:.0f} MB")
    print(f"memory of the recorder, MB: {' '.join(f'{value:.0f}' for value in memory_mb)}")


if __name__ == "__main__":
    main()
