# SPDX-License-Identifier: BSD-3-Clause
"""A process that was stopped knows it; one that was only busy does not believe so."""

import os
import signal
import subprocess
import sys

import pytest

PROGRAM = """
import signal, sys, time
import piezo_ros.heartbeat

# Only the main thread gets the signal, when it wants it.
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT])
heartbeat = piezo_ros.heartbeat.Heartbeat()
print("begun", flush=True)
{work}
print(heartbeat.standstill_s())
"""
STOPPED_S = 0.9
"""A process is stopped for longer; gaps of a busy computer are shorter."""
HEAR = "signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCONT])"
BUSY = f"{HEAR}\nend_s = time.process_time() + 1.5\nwhile time.process_time() < end_s: pass"
WAIT = "sys.stdin.readline()"
SOON = f"{HEAR}\n{WAIT}\nwhile heartbeat._standstill_s < {STOPPED_S}: time.sleep(0.01)"
LONG_AFTER = f"{HEAR}\n{WAIT}\ntime.sleep(piezo_ros.heartbeat.SIGNAL_DELAY_S + 0.5)"
BEFORE_IT_WAS_TOLD = f"""
{WAIT}
while heartbeat._gap_s < {STOPPED_S}: time.sleep(0.01)
assert heartbeat.standstill_s() == 0.0
{HEAR}
"""
TWICE = f"{SOON}\nassert heartbeat.standstill_s() > 0.0"


def begun(work):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(work=work)], stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert process.stdout.readline() == "begun\n"
    return process


def answer_of_stopped(work):
    process = begun(work)
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)
    try:
        process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGCONT)
    return float(process.communicate("go on\n")[0])


@pytest.mark.parametrize("asked", [SOON, LONG_AFTER, BEFORE_IT_WAS_TOLD])
def test_a_stopped_process_knows_for_how_long_whenever_it_is_asked(asked):
    assert answer_of_stopped(asked) > STOPPED_S


def test_a_standstill_is_told_once():
    assert answer_of_stopped(TWICE) == 0.0


def test_a_busy_process_does_not_take_itself_for_stopped():
    assert float(begun(BUSY).communicate()[0]) == 0.0
