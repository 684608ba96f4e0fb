# SPDX-License-Identifier: BSD-3-Clause
"""Wake once a millisecond and do nothing: python bare_timer.py SECONDS [PRIORITY].

Prints how many wakes there were, how many came later than a millisecond, and the latest (ms), as
JSON: what this machine does to a loop that needs no time.
"""

import contextlib
import json
import os
import subprocess
import sys
import time

PERIOD_S = 1e-3
PRIORITY = 40


def main():
    """Wake as often as asked for."""
    seconds = float(sys.argv[1])
    priority = int(sys.argv[2]) if len(sys.argv) > 2 else PRIORITY
    if priority:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    late_s, due_s = [], time.monotonic()
    for _ in range(round(seconds / PERIOD_S)):
        due_s += PERIOD_S
        time.sleep(max(due_s - time.monotonic(), 0.0))
        late_s.append(time.monotonic() - due_s)
    print(json.dumps({"wakes": len(late_s), "late": sum(late > PERIOD_S for late in late_s),
                      "latest_ms": 1e3 * max(late_s)}))


def bare_timer(seconds, priority=PRIORITY):
    """Run it as a process of its own; return what it prints."""
    done = subprocess.run([sys.executable, __file__, str(seconds), str(priority)],
                          capture_output=True, check=True, text=True)
    return json.loads(done.stdout)


if __name__ == "__main__":
    main()
