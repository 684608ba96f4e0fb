# SPDX-License-Identifier: BSD-3-Clause
"""Run all benchmarks and print one table: python run.py [--rounds N].

What is compared is measured side by side in each round; of the rounds the table tells the median
and the spread. An hour of a stream is played once, check, identify and diagnose are timed once over
the number of rows, and identification is set beside its peers once, over many draws of the noise.
"""

import argparse
import os
import random
from pathlib import Path

import numpy as np
import peers
from command_speed import SUITE_START, answer_times_s, first_recording_s
from command_speed import TARGETS as ANSWER_TARGETS
from computing_time import computing_times_s
from diagnosis_speed import CASES, MANY_SAMPLES, SAMPLES, diagnosis_times_s
from history import HISTORY, PAGE, keep, page_of
from hysteresis_speed import look_up_error_percent, samples_per_s
from loop_speed import LOCKSTEP, closed_loop, ping_pong_round_trips, tick_round_trips
from paced import paced_run
from paced_onboard import onboard_run
from rows_speed import TARGETS as ROWS_TARGETS
from rows_speed import measure as measure_rows
from stream_length import TARGETS as STREAM_TARGETS
from stream_length import measure as measure_streams
from table import Measurements, show, write

OUTPUT = Path(__file__).parents[1] / "runs" / "bench"
LEVELS = (50, 200, 500, 1000)
HYSTERESIS_SAMPLES_PER_S = 5e7
SIMULATED_S, SIMULATED_ON_BOARD_S = 20.0, 120.0
PACED_S = 5.0
ONBOARD_PACED_S = 20.0
BUSY_PROCESSES = 2
ROUND_TRIPS = 5000
MICROSECONDS = 1e6

SPEED = "simulated s per s"
ANSWERED, ON_BOARD = {"feedback": "remote"}, {"feedback": "onboard"}
LOOPS = {
    "loop on board, stage and controller": dict(
        simulated_s=SIMULATED_ON_BOARD_S,
        executables={"stage": LOCKSTEP, "controller": ON_BOARD}),
    "loop on board, stage, controller and recorder": dict(
        simulated_s=SIMULATED_ON_BOARD_S,
        executables={"stage": LOCKSTEP, "controller": ON_BOARD, "recorder": {}}),
    "loop, stage and controller": dict(executables={"stage": LOCKSTEP, "controller": ANSWERED}),
    "loop, stage, controller and recorder": dict(
        executables={"stage": LOCKSTEP, "controller": ANSWERED, "recorder": {}}),
}


def hysteresis(rows):
    """Add the Preisach model's speed, and how often that of its peers it is."""
    for levels in LEVELS:
        speeds = samples_per_s(levels)
        for name, speed in speeds.items():
            direction, _, peer = name.partition(", ")
            title = f"Preisach {direction}, {levels} levels"
            if peer:
                rows[f"{title}: over {peer}", "times"].append(speeds[direction] / speed)
            else:
                rows[title, "samples/s"].append(speed)
        rows[f"Preisach, {levels} levels: error of the Everett look-up", "% of span"].append(
            look_up_error_percent(levels))


def loops(rows):
    """Add the speeds of the closed loop."""
    speeds = {name: closed_loop(OUTPUT / "loop", **{"simulated_s": SIMULATED_S, **loop})
              for name, loop in LOOPS.items()}
    for name, speed in speeds.items():
        rows[name, SPEED].append(speed)
    onboard, recorded, answered, _ = speeds.values()
    rows["loop on board over loop by messages", "times"].append(onboard / answered)
    rows["loop on board and recorded over loop by messages", "times"].append(recorded / answered)


def round_trips(rows):
    """Add the tick's round trip, and the time to compute an answer, beside the ping-pong's."""
    tick_s = tick_round_trips(OUTPUT / "tick", PACED_S)
    ping_s = ping_pong_round_trips(OUTPUT / "ping", ROUND_TRIPS)
    for order, computing_s in computing_times_s().items():
        name = f"computing an answer, controller of order {order}"
        for percent in (50, 99):
            computing = np.percentile(computing_s, percent)
            rows[f"{name}, p{percent}", "us"].append(computing * MICROSECONDS)
        rows[f"{name}, p99: over ping-pong", "times"].append(computing / np.percentile(ping_s, 99))
    for percent in (50, 99):
        tick, ping = np.percentile(tick_s, percent), np.percentile(ping_s, percent)
        rows[f"round trip, tick, p{percent}", "us"].append(tick * MICROSECONDS)
        rows[f"round trip, bare ping-pong, p{percent}", "us"].append(ping * MICROSECONDS)
        rows[f"round trip, p{percent}: tick over ping-pong", "times"].append(tick / ping)


def paced(rows):
    """Add what a stage that keeps the wall clock's pace loses, and how late its answers are."""
    run = paced_run(OUTPUT / "paced", PACED_S)
    rows["paced, 1 kHz: samples lost", "samples"].append(run.lost_samples)
    rows["paced, 1 kHz: ticks other than uploaded", "ticks"].append(run.disturbed_ticks)
    rows["paced, 1 kHz: answers missed", "of 1000"].append(1000 * run.missed_feedback / run.ticks)
    for name, count in run.histogram.items():
        if name.endswith("_ms") and "longest" not in name:
            title = name.removesuffix("_ms").replace("_", " ")
            rows[f"paced, 1 kHz: {title} ms", "of 1000"].append(1000 * int(count) / run.ticks)


def paced_onboard(rows):
    """Add how many ticks of the loop on board are late, idle and busy, beside a bare timer's."""
    for load, processes in (("idle", 0), (f"{BUSY_PROCESSES} busy processes", BUSY_PROCESSES)):
        run = onboard_run(OUTPUT / "paced_onboard", ONBOARD_PACED_S, processes)
        name = f"paced, 1 kHz, loop on board, {load}"
        rows[f"{name}: feedback missed", "ticks"].append(
            run.missed_feedback + run.ticks - run.fed_back_ticks)
        rows[f"{name}: deadlines missed", "%"].append(run.missed_percent)
        rows[f"{name}: bare timer late by a tick", "%"].append(run.bare_percent)
        for bound, count in run.histogram.items():
            rows[f"{name}: begun {bound}", "%"].append(100.0 * count / run.counted_ticks)


def diagnosis(rows):
    """Add how long each verdict takes, and how often the time of a simulation that is."""
    for samples in (SAMPLES, MANY_SAMPLES):
        for name in CASES:
            simulation_s, diagnosis_s = diagnosis_times_s(name, samples)
            row = f"diagnosis of {samples:,} samples, {name}"
            rows[row, "s"].append(diagnosis_s)
            rows[f"{row}: over a simulation", "times"].append(diagnosis_s / simulation_s)


def answers(rows):
    """Add how long commands take to answer what costs no work, and the suite to begin with it."""
    for name, time_s in answer_times_s().items():
        rows[name, "s"].append(time_s)
    rows[SUITE_START, "s"].append(first_recording_s())


DIAGNOSIS_S = {SAMPLES: 30.0, MANY_SAMPLES: 60.0}
TARGETS = {
    "paced, 1 kHz: samples lost": {"at_most": 0},
    "paced, 1 kHz: ticks other than uploaded": {"at_most": 0},
    "paced, 1 kHz, loop on board, idle: feedback missed": {"at_most": 0},
    "paced, 1 kHz, loop on board, idle: deadlines missed": {"at_most": 0.01},
    f"paced, 1 kHz, loop on board, {BUSY_PROCESSES} busy processes: feedback missed": {
        "at_most": 0},
    "loop, stage and controller": {"at_least": 2.0},
    "loop on board, stage and controller": {"at_least": 15.0},
    "loop on board, stage, controller and recorder": {"at_least": 10.0},
    "loop on board over loop by messages": {"at_least": 3.0},
    "round trip, p50: tick over ping-pong": {"at_most": 2.0},
    "computing an answer, controller of order 15, p99": {"at_most": 100.0},
} | {f"Preisach {direction}, {levels} levels": {"at_least": HYSTERESIS_SAMPLES_PER_S}
     for levels in LEVELS for direction in ("forward", "inverse")} | {
     f"diagnosis of {samples:,} samples, {name}": {"at_most": limit_s}
     for samples, limit_s in DIAGNOSIS_S.items() for name in CASES}


def main():
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3, help="how often all is measured")
    rounds = parser.parse_args().rounds
    # Out of the way of whatever else runs on this machine.
    os.environ["ROS_DOMAIN_ID"] = str(random.randint(1, 100))
    OUTPUT.mkdir(parents=True, exist_ok=True)
    print(f"{os.cpu_count()} cores; load average before: {os.getloadavg()[0]:.1f}")
    measured = Measurements()
    for number in range(1, rounds + 1):
        for measure in (answers, hysteresis, loops, round_trips, paced, paced_onboard,
                        diagnosis):
            print(f"round {number} of {rounds}: {measure.__name__.replace('_', ' ')} ...",
                  flush=True)
            measure(measured)
    print("an hour of a stream ...", flush=True)
    measure_streams(measured)
    print("check, identify and diagnose over the number of rows ...", flush=True)
    measure_rows(measured)
    print("identification beside its peers ...", flush=True)
    peers.measure(measured)
    rows = measured.table(TARGETS | ANSWER_TARGETS | STREAM_TARGETS | ROWS_TARGETS)
    show(rows)
    write(rows, OUTPUT / "table.json")
    keep(rows)
    PAGE.write_text(page_of(), encoding="utf-8")
    print(f"written: {OUTPUT / 'table.json'}, {HISTORY}, {PAGE}")


if __name__ == "__main__":
    main()
