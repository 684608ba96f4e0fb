# SPDX-License-Identifier: BSD-3-Clause
"""What looks after the loop while it runs."""

from types import SimpleNamespace

from piezo_stage_driver.node.stage_loop import StageLoop


def test_threads_that_came_since_are_raised_by_who_watches(monkeypatch):
    supervisor = SimpleNamespace(watch=lambda: None, hangs=False)
    loop = StageLoop(supervisor, None, SimpleNamespace(real_time_priority=40), *[None] * 3)
    raised = []
    monkeypatch.setattr(loop.real_time, "raise_new_threads", lambda: raised.append(True))
    loop.watch()
    assert raised
