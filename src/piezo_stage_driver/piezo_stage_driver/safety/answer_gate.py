# SPDX-License-Identifier: BSD-3-Clause
"""Filter of feedback answers: only those with the number of the present run may act."""

import secrets

NOT_GIVEN = 0
FIRST_RUN_BITS = 32


class AnswerGate:
    """Distinguish answers of the client that the stage tracks for from those of others.

    Numbering of the runs starts at random, so that an answer to a stage before a restart does not
    match one of its new runs. Of answers to the present `run`, `foreign` counts those of other
    clients, more than `max_foreign` of which stop the stage; `stale` counts those for earlier runs,
    which are ignored.
    """

    def __init__(self, max_foreign: int = 0):
        self._max_foreign = max_foreign
        self._first_run = self.run = (secrets.randbits(FIRST_RUN_BITS) + 1) << 16
        self.foreign = self.stale = 0
        self._numbered = False

    @property
    def cause(self) -> str:
        """Return why the stage must stop; empty if it need not."""
        if self.foreign <= self._max_foreign:
            return ""
        return (f"{self.foreign} feedback answer(s) came from others than the client that the "
                "stage tracks for: end the other publisher of feedback")

    def begin(self) -> int:
        """Begin a run; return its number."""
        self.run += 1
        self.foreign = self.stale = 0
        self._numbered = False
        return self.run

    def admits(self, run: int, alone: bool) -> bool:
        """Return whether an answer may act, given its run number, 0 if it has none.

        `alone` tells that a single node publishes feedback.
        """
        if run == self.run:
            self._numbered = True
            return True
        if run == NOT_GIVEN and alone and not self._numbered:
            return True
        if self._first_run < run < self.run:
            self.stale += 1
        else:
            self.foreign += 1
        return False
