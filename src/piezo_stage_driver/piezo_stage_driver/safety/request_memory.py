# SPDX-License-Identifier: BSD-3-Clause
"""Requests that come twice act once: the second gets the answer of the first."""

from collections import OrderedDict

REMEMBERED_REQUESTS = 256
WITHOUT_NUMBER = 0


class RequestMemory:
    """Responses to the last requests that bore a number."""

    def __init__(self):
        self._late = OrderedDict()

    def repeats(self, number: int, late) -> bool:
        """Whether a request has been met before; it then gets the answer of the first.

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
