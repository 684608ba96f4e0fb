# SPDX-License-Identifier: BSD-3-Clause
"""Whose feedback answers may act: those that bear the number of the present run."""

import secrets

NOT_GIVEN = 0
FIRST_RUN_BITS = 32


class AnswerGate:
    """Tell the answers of the client that the stage tracks for from those of others.

    Runs are numbered from a random number on, so that an answer for a stage that was started
    again is not taken for one of its new runs.

    Parameters
    ----------
    max_foreign : int
        More foreign answers in a run stop the stage.

    Attributes
    ----------
    run : int
        Number of the present run.
    foreign : int
        Answers of others in this run.
    stale : int
        Answers of the runs before, which are let go without complaint.
    """

    def __init__(self, max_foreign: int = 0):
        self._max_foreign = max_foreign
        self._first_run = self.run = (secrets.randbits(FIRST_RUN_BITS) + 1) << 16
        self.foreign = self.stale = 0
        self._numbered = False

    @property
    def cause(self) -> str:
        """Tell why the stage must stop; empty where it need not."""
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
        """Tell whether an answer may act.

        Parameters
        ----------
        run : int
            That it bears; 0 where it bears none.
        alone : bool
            Whether one node alone publishes feedback.
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
