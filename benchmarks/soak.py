# SPDX-License-Identifier: BSD-3-Clause
"""Kill and stop nodes and operators for long: python soak.py [--seconds S] [--rounds N] [--seed N].

Two sessions run beside each other, one in lockstep and one paced. Each round of a session draws a
run, who goes away in it, and how. The rest must come to rest in time and say why; the recording
must be readable, and the next run succeed, while nobody but who went away is started anew. The
status is 1 where anything of this failed, or a request was not answered.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

from deaths import MODES, SIGNALS, TIMINGS, VICTIMS, WORKERS, Session

OUTPUT = Path(__file__).parents[1] / "runs" / "soak"
PATIENCE_S = 30.0
KEPT_DIRECTORIES = 4


def soak(options):
    """Run one session; return its account."""
    directory = OUTPUT / options.timing
    directory.mkdir(parents=True)
    os.environ["ROS_DOMAIN_ID"] = str(options.domain)
    draw = random.Random(f"{options.seed} {options.timing}")
    rounds, faults, begun_s = 0, [], time.monotonic()
    with Session(directory, options.timing, PATIENCE_S) as session:
        while rounds < options.rounds and time.monotonic() - begun_s < options.seconds:
            rounds += 1
            name, victim, number, mode = map(draw.choice, (
                list(WORKERS), VICTIMS, SIGNALS, MODES))
            failed = session.round(name, victim, number, mode, draw.uniform(0.0, 1.0))
            faults += failed
            print(f"{time.monotonic() - begun_s:4.0f} s, {options.timing}, round {rounds}, "
                  f"{len(session.unanswered)} unanswered: {name}, {victim}, {number.name}, {mode}"
                  f"{''.join(f'; {fault}' for fault in failed)}", flush=True)
            if rounds > KEPT_DIRECTORIES and not faults:
                for when in "before", "after":
                    shutil.rmtree(directory / f"{rounds - KEPT_DIRECTORIES}_{when}")
        return {"timing": options.timing, "rounds": rounds, "faults": faults,
                "unanswered": session.unanswered, "longest_s": session.longest_s,
                "seconds": time.monotonic() - begun_s}


def main():
    """Run the sessions; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=900.0, help="of wall time")
    parser.add_argument("--rounds", type=int, default=1000, help="at most, of a session")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--timing", choices=TIMINGS, help="of one session alone")
    parser.add_argument("--domain", type=int, help="of this session")
    parser.add_argument("--account", type=Path, help="file that gets the account of this session")
    options = parser.parse_args()
    if options.timing:
        options.account.write_text(json.dumps(soak(options)))
        return 0
    shutil.rmtree(OUTPUT, ignore_errors=True)
    domains = random.Random().sample(range(1, 101), len(TIMINGS))
    OUTPUT.mkdir(parents=True)
    files = [OUTPUT / f"{timing}.json" for timing in TIMINGS]
    sessions = [subprocess.Popen(
        [sys.executable, __file__, "--seconds", str(options.seconds), "--rounds",
         str(options.rounds), "--seed", str(options.seed), "--timing", timing, "--domain",
         str(domain), "--account", str(file)])
        for timing, domain, file in zip(TIMINGS, domains, files, strict=True)]
    for session in sessions:
        session.wait()
    accounts = [json.loads(file.read_text()) for file in files]
    for account in accounts:
        print(f"{account['timing']}: {account['rounds']} rounds in {account['seconds']:.0f} s, "
              f"{len(account['unanswered'])} unanswered requests, {len(account['faults'])} faults; "
              f"the longest end of a run took {account['longest_s']:.1f} s")
        for line in (*account["faults"], *account["unanswered"]):
            print(f"  {line}")
    unanswered = sum(len(account["unanswered"]) for account in accounts)
    print(f"{sum(account['rounds'] for account in accounts)} rounds, {unanswered} unanswered")
    return 1 if unanswered or any(account["faults"] for account in accounts) else 0


if __name__ == "__main__":
    sys.exit(main())
