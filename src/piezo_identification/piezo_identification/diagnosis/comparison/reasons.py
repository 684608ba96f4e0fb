# SPDX-License-Identifier: BSD-3-Clause
"""Why an effect can neither be named nor excluded."""

from dataclasses import dataclass
from enum import StrEnum


class Reason(StrEnum):
    """Kind of reason, for use by programs; users read the sentence."""

    NOT_EXCITED = "not excited"
    IMPOSSIBLE = "impossible"
    SAME_AS_OTHER_PARAMETERS = "same as other parameters"
    LIKE_ANOTHER = "like another effect"
    WORSE_ON_HELD_OUT = "worse on held-out data"


@dataclass(frozen=True)
class Undecided:
    """A reason with its sentence."""

    reason: Reason

    sentence: str
    """Sentence without its end."""


OTHER_PARAMETERS = Undecided(Reason.SAME_AS_OTHER_PARAMETERS,
                             "here a model with slightly other parameters does the same")
