# SPDX-License-Identifier: BSD-3-Clause
"""Whoever is killed or hangs in a run, the rest ends it in order, and the next run works.

The short form of ``make soak``: both take their rounds from ``benchmarks/deaths.py``.
"""

import functools
import os
import signal
from itertools import product

import pytest

TIMEOUT_S = 300.0
# Each recorder that was killed once kept room in what the controller sends from: behind two of them
# the law of a model of real size found none.
KILLED_RECORDERS = [("lockstep", "track", "recorder", signal.SIGKILL)] * 2
# The rest differ from these in what they have in common with another one; where the time comes
# from is of no matter to who notices that somebody is gone, and lockstep waits for nothing. The
# operator's death is that of a client in test_stage_faults.py.
OTHERS = [
    ("lockstep", "track", "worker", signal.SIGKILL),
    ("lockstep", "run_experiment", "stage", signal.SIGKILL),
    ("lockstep", "run_experiment", "recorder", signal.SIGSTOP),
]
if os.environ.get("LONG_TESTS"):
    OTHERS = list(product(("lockstep", "paced"), ("track", "run_experiment"),
                          ("stage", "recorder", "worker", "operator"),
                          (signal.SIGKILL, signal.SIGSTOP)))


@pytest.fixture(scope="module")
def session_of(tmp_path_factory):
    """Returns the session of a timing, which is begun once."""
    import deaths

    sessions = []

    @functools.cache
    def session_of(timing):
        session = deaths.Session(tmp_path_factory.mktemp(timing), timing, TIMEOUT_S)
        sessions.append(session.__enter__())
        return session

    yield session_of
    for session in sessions:
        session.__exit__()


@pytest.mark.parametrize(("timing", "name", "victim", "number"), [*KILLED_RECORDERS, *OTHERS])
def test_whoever_goes_away_the_rest_ends_in_order(session_of, timing, name, victim, number):
    session = session_of(timing)
    assert session.round(name, victim, number, "composite") == []
    assert session.unanswered == []
