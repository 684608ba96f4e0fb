# SPDX-License-Identifier: BSD-3-Clause
"""Limit the memory of a node for the sake of the stage, and order who is ended first."""

import os
import resource
from contextlib import suppress
from pathlib import Path

OOM_SCORE, MOST_OOM_SCORE = 500, 1000
"""Added to the kernel's score of a process that is to be ended before the stage; largest score."""

CONTROL_GROUP_LIMITS = ("/sys/fs/cgroup/memory.max",
                        "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def machine_bytes() -> int:
    """Return the memory of this machine, or of the container of this process, in bytes."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in CONTROL_GROUP_LIMITS:
        with suppress(OSError, ValueError):  # "max" for none
            limits.append(int(Path(path).read_text(encoding="ascii")))
    return min(limits)


def limit_memory(percent: float) -> None:
    """Make allocations of this process fail beyond a share of `machine_bytes`, in percent.

    Memory mapped from files or shared with others does not count, and neither does address space
    that is only reserved, as for the heaps of threads.
    """
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = int(machine_bytes() * percent / 100.0)
    resource.setrlimit(
        resource.RLIMIT_DATA, (limit if most == resource.RLIM_INFINITY else min(limit, most), most))


def end_before_stage() -> None:
    """Make the kernel end this process before the stage when memory runs out."""
    score = Path("/proc/self/oom_score_adj")
    with suppress(OSError, ValueError):  # Linux only
        inherited = int(score.read_text(encoding="ascii"))
        score.write_text(str(min(inherited + OOM_SCORE, MOST_OOM_SCORE)), encoding="ascii")
