# SPDX-License-Identifier: BSD-3-Clause
"""A process that was stopped knows it; one that was only busy does not believe so."""

import os
import signal
import subprocess
import sys

PROGRAM = """
import sys, time
from piezo_ros.heartbeat import Heartbeat

heartbeat = Heartbeat()
print("begun", flush=True)
{work}
print(heartbeat.standstill_s())
"""
BUSY = "end_s = time.process_time() + 1.5\nwhile time.process_time() < end_s: pass"
WAITING = "sys.stdin.readline()\ntime.sleep(0.5)  # a beat behind the standstill"


def begun(work):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(work=work)], stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert process.stdout.readline() == "begun\n"
    return process


def test_a_stopped_process_knows_for_how_long():
    process = begun(WAITING)
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)
    try:
        process.wait(timeout=2.0)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGCONT)
    assert float(process.communicate("go on\n")[0]) > 1.5


def test_a_busy_process_does_not_take_itself_for_stopped():
    assert float(begun(BUSY).communicate()[0]) == 0.0
