# SPDX-License-Identifier: BSD-3-Clause
"""Run the demo under each BLAS kernel and print how far its figures agree.

    python benchmarks/demo_by_kernel.py [--summaries FILE...]

Under which kernels, tools/kernels.py decides. The status is 1 if a figure agrees less than the docs
state.
"""

import argparse
import json
import math
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))

from kernels import VARIABLE, kernels_that_work  # noqa: E402

OUTPUT = ROOT / "runs" / "kernels"
# As docs/first_run.md states it: the errors of tracking, in percent of the reference.
LARGEST_DIFFERENCE_PERCENT = 0.03
# Taken by the clock, or told by the thesis.
NOT_COMPARED = ("wall_s", "lockstep_ratio", "thesis_e_rms_percent")
TRACKING = ("tracking", "tracking_after")
ROW = "{:55} {:>12} {:>12} {:>12}"


def run_demo(kernel):
    """Run the demo under a kernel; return its summary."""
    output = OUTPUT / kernel
    subprocess.run([ROOT / "run", "piezo_studies", "demo", "--output", output, "--first-part"],
                   check=True, env=os.environ | {VARIABLE: kernel})
    return json.loads((output / "summary.json").read_text(encoding="utf-8"))


def figures(summary, name=""):
    """Yield the name and the value of every number and word of a summary."""
    if isinstance(summary, dict):
        for key, value in summary.items():
            if key not in NOT_COMPARED:
                yield from figures(value, f"{name} {key}".strip())
    elif isinstance(summary, list):
        for number, value in enumerate(summary):
            yield from figures(value, f"{name} {_label(value, number)}")
    else:
        yield name, summary


def _label(entry, number):
    if isinstance(entry, dict) and "mode" in entry:
        return f"{entry['frequency_hz']:g} Hz {entry['mode']}"
    return entry["name"] if isinstance(entry, dict) and "name" in entry else number


def compare(summaries):
    """Return for every number its name, its smallest and its largest value under the kernels.

    ValueError is raised if the summaries differ in a word or in which figures they have, as where a
    diagnosis names another effect.
    """
    first, *others = [dict(figures(summary)) for summary in summaries]
    for other in others:
        differing = sorted(
            name for name in {*first, *other}
            if name not in first or name not in other
            or not _is_number(first[name]) and first[name] != other[name])
        if differing:
            raise ValueError(f"the kernels do not agree on {', '.join(differing)}")
    values = {name: [first[name], *(other[name] for other in others)] for name in first}
    return [(name, min(found), max(found)) for name, found in values.items()
            if _is_number(first[name])]


def _is_number(value):
    return isinstance(value, float | int) and not isinstance(value, bool)


def agreeing_digits(low, high):
    """Return how many significant digits two values have in common."""
    if low == high:
        return 15
    return max(0, math.floor(-math.log10((high - low) / max(abs(low), abs(high)))))


def apart(rows):
    """Return the names of tracking errors that are further apart than the docs state."""
    return [name for name, low, high in rows if name.split()[0] in TRACKING
            and name.endswith("_percent") and high - low > LARGEST_DIFFERENCE_PERCENT]


def main(arguments=None):
    """Run the demos, or read those of before; print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--summaries", type=Path, nargs="+", metavar="FILE",
                        help="compare these summary.json instead of running the demo")
    options = parser.parse_args(arguments)
    if options.summaries:
        summaries = [json.loads(path.read_text(encoding="utf-8")) for path in options.summaries]
    else:
        own, others = kernels_that_work()
        names = [*own, *others]
        if len(names) < 2:
            print("kernels: no other kernel can be chosen on this processor; nothing to compare")
            return 0
        print(f"kernels: {', '.join(names)}", flush=True)
        summaries = [run_demo(kernel) for kernel in names]
    try:
        rows = compare(summaries)
    except ValueError as error:
        print(f"kernels: {error}", file=sys.stderr)
        return 1
    print(ROW.format("figure", "smallest", "largest", "digits"))
    for name, low, high in rows:
        print(ROW.format(name, f"{low:.6g}", f"{high:.6g}", agreeing_digits(low, high)))
    failed = apart(rows)
    if failed:
        print(f"kernels: more than {LARGEST_DIFFERENCE_PERCENT:g} % apart: {', '.join(failed)}",
              file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
