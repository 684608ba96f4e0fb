# SPDX-License-Identifier: BSD-3-Clause
"""Why a run ended is read from the values of the stage's diagnostics, not from their sentence."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from piezo_ros.stage_runs import stage_watch
from piezo_ros.stage_runs.stage_watch import ACTIVE, StageWatch


class SilentNode:
    """A node that sees nobody."""

    def get_namespace(self):
        return "/"

    def create_subscription(self, *_):
        return None


class There:
    """The stage, which stays."""

    gone = False

    def __init__(self, *_):
        pass


@pytest.mark.parametrize(("level", "message", "active", "why"), [
    (DiagnosticStatus.OK, "at rest", False, "it was deactivated"),
    (DiagnosticStatus.OK, "not active", True, "somebody else called stop_tracking"),
    (DiagnosticStatus.ERROR, "the sensor is stuck", False, "the sensor is stuck"),
])
def test_why_a_run_ended_is_told_by_values(monkeypatch, level, message, active, why):
    monkeypatch.setattr(stage_watch, "Presence", There)
    monkeypatch.setattr(stage_watch, "NEWS_TIMEOUT_S", 0.0)
    watch = StageWatch(SilentNode())
    watch._on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(
        name="/stage: stage", level=level, message=message,
        values=[KeyValue(key=ACTIVE, value=str(active))])]))
    assert watch.why_ended() == why
