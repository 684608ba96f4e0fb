# SPDX-License-Identifier: BSD-3-Clause
"""Requests that come twice act once: the second gets the answer of the first."""

from collections import OrderedDict
from typing import Any, Protocol

REMEMBERED_REQUESTS = 256
WITHOUT_NUMBER = 0


class Late(Protocol):
    """A response that is still to be given."""

    def share(self, other: Any) -> None:
        """Give the same response to another call of the same request."""


class RequestMemory:
    """Responses to the last requests that bore a number."""

    def __init__(self) -> None:
        self._late: OrderedDict[int, Late] = OrderedDict()

    def repeats(self, number: int, late: Late) -> bool:
        """Tell whether a request has been met before; it then gets the answer of the first.

        Parameters
        ----------
        number : int
            That the client gave the request; 0 where it gave none.
        late : LateResponse
            Of this call.
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
