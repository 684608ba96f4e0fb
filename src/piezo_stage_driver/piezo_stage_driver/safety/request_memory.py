# SPDX-License-Identifier: BSD-3-Clause
"""Detection of repeated requests: the second one gets the answer of the first."""

from collections import OrderedDict
from typing import Any, Protocol

REMEMBERED_REQUESTS = 256
WITHOUT_NUMBER = 0


class Late(Protocol):
    """A response that has not been given yet."""

    def share(self, other: Any) -> None:
        """Give the same response to another call of the same request."""


class RequestMemory:
    """Responses to the last requests that had a number."""

    def __init__(self) -> None:
        self._late: OrderedDict[int, Late] = OrderedDict()

    def repeats(self, number: int, late: Late) -> bool:
        """Return whether a request is a repetition; it then gets the answer of the first.

        The number is that which the client gave the request; 0 if it gave none.
        """
        if number == WITHOUT_NUMBER:
            return False
        first = self._late.get(number)
        if first is None:
            self._late[number] = late
            if len(self._late) > REMEMBERED_REQUESTS:
                self._late.popitem(last=False)
            return False
        first.share(late)
        return True
