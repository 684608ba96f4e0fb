# SPDX-License-Identifier: BSD-3-Clause
"""A response given after its node has ended is dropped, and one given in time is sent."""

from types import SimpleNamespace

import pytest

from piezo_ros.late_responses import LateResponse


class Executor:
    def create_task(self, work, *arguments):
        work(*arguments)


@pytest.mark.parametrize(("executor", "expected"), [(Executor(), ["answer"]), (None, [])])
def test_response_is_sent_while_the_node_has_an_executor(executor, expected):
    sent = []
    late = LateResponse(SimpleNamespace(executor=executor), "answer")
    late.send_by(sent.append)
    late.give()
    assert sent == expected
