# SPDX-License-Identifier: BSD-3-Clause
"""What a chunk of a stream takes after 1, 10 and 60 minutes of it: python stream_length.py.

Controller and stage without messages, in one process: the chunk is planned, loaded behind what the
stage has, played tick by tick, and its blocks are taken into the run's account.
"""

import argparse
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np
from stage_model import SAMPLE_RATE_HZ, stage_model
from table import Measurements, show

from piezo_controller.feedforward.streamed import plan_stream
from piezo_controller.references.reference import Reference, trajectory
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import VoltageLimits

MINUTES = (1, 10, 60)
SAMPLES_PER_TICK = 40
REFERENCE = Reference("random", (300.0,), (30.0,), (), 50.0, seed=1)
# Chunks before each of the minutes over which the time is averaged.
AVERAGED_CHUNKS = 100
TARGETS = {f"stream, {what} after {minutes} min: over that after {MINUTES[0]} min":
           {"at_most": 1.2}
           for what in ("time of a chunk", "memory") for minutes in MINUTES[1:]}


class Sink:
    """A backend that measures nothing and keeps nothing."""

    sample_rate_hz = SAMPLE_RATE_HZ

    def exchange(self, voltage_v):
        """Take voltages; the displacement stays where it is."""
        return np.zeros(len(voltage_v))


def measure(rows, minutes=MINUTES):
    """Add the planning of the longest stream, and time and memory of its chunks on their way."""
    begin_s = time.perf_counter()
    samples = round(60 * minutes[-1] * SAMPLE_RATE_HZ)
    plan = plan_stream(trajectory(REFERENCE), samples, stage_model())
    run = TrackingRun(plan, samples)
    rows[f"stream, planning of {minutes[-1]} min", "s"].append(time.perf_counter() - begin_s)
    times_s, memory_mb = _play(plan, run, minutes)
    for minute in minutes:
        rows[f"stream, time of a chunk of 0.1 s after {minute} min", "ms"].append(
            1e3 * times_s[minute])
        rows[f"stream, memory of the process after {minute} min", "MB"].append(memory_mb[minute])
    for minute in minutes[1:]:
        for what, values in (("time of a chunk", times_s), ("memory", memory_mb)):
            rows[f"stream, {what} after {minute} min: over that after {minutes[0]} min",
                 "times"].append(values[minute] / values[minutes[0]])


def _play(plan, run, minutes):
    """Play the stream to its end; return time (s) and memory (MB) by the minutes."""
    engine = StageEngine(Sink(), VoltageLimits(-20.0, 120.0, 2.0e6),
                         samples_per_tick=SAMPLES_PER_TICK)
    engine.commands.load_feedforward(plan.once_voltage_v, [])
    engine.commands.start_tracking(feedback=False)
    ends = {round(60 * minute * SAMPLE_RATE_HZ): minute for minute in minutes}
    last_s, times_s, memory_mb = [], {}, {}
    begin_s = time.process_time()
    for voltage_v in plan.chunks():
        engine.commands.load_feedforward(voltage_v, [], append=True)
        for _ in range(len(voltage_v) // SAMPLES_PER_TICK):
            run.take(engine.advance().displacement_um)
        now_s = time.process_time()  # of what else the machine does nothing is counted
        last_s = [*last_s[1 - AVERAGED_CHUNKS:], now_s - begin_s]
        begin_s = now_s
        reached = [end for end in ends if run.samples >= end]
        for end in reached:
            minute = ends.pop(end)
            times_s[minute], memory_mb[minute] = float(np.median(last_s)), _memory_mb()
    return times_s, memory_mb


def _memory_mb():
    """Memory that the process holds now (MB)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def main():
    """Measure once, in shorter streams if so asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, nargs="+", default=list(MINUTES),
                        help="where to look, in minutes of the stream, ascending")
    minutes = parser.parse_args().minutes
    rows = Measurements()
    print(f"{os.cpu_count()} cores; load average before: {os.getloadavg()[0]:.1f}")
    measure(rows, minutes)
    table = rows.table(TARGETS)
    show(table)
    return int(any("MISSED" in row.verdict for row in table))


if __name__ == "__main__":
    sys.exit(main())
