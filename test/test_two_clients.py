# SPDX-License-Identifier: BSD-3-Clause
"""Clients that load between each other's calls or give up: nothing plays that nobody follows."""

import array

import numpy as np
import pytest
from piezo_interfaces.msg import FeedbackLaw, SampleBlock, StateSpace
from piezo_interfaces.srv import LoadFeedback, LoadFeedforward, StartTracking

from piezo_ros.requests.calls import CallFailed, call_service
from piezo_ros.stage_runs import stage_tracking
from piezo_ros.stage_runs.stage_tracking import StageTracker

OWN_V, OTHER_V = np.linspace(0.0, 10.0, 400), np.linspace(0.0, -10.0, 400)
LAW = FeedbackLaw(
    tick=StateSpace(a=[1.0], b=[1.0], c=[1.0], d=1.0), observer=[0.5], max_feedback_v=20.0,
    once_expected_um=[0.0], model=StateSpace(a=[0.9], b=[0.1], c=[1.0]),
    model_gains_um_per_v=[0.3])
SENTENCE = "another feedforward was loaded since: let one client at a time use the stage"


@pytest.fixture(scope="module")
def shared(nodes):
    return nodes.start(namespace="/shared")


@pytest.fixture
def stage(shared):
    """A stage at rest."""
    shared.samples(shared.play([0.0]).last_sample)
    shared.forget()
    return shared


def played(stage):
    return stage.samples().flagged(SampleBlock.FLAG_TRACKING)


def test_what_was_loaded_since_is_neither_started_nor_added_to(stage):
    loaded = [stage.load(voltage_v) for voltage_v in (OWN_V, OTHER_V)]
    assert all(response.success for response in loaded), loaded
    own, other = (response.feedforward_id for response in loaded)
    assert 0 not in (own, other) and own != other
    for request in (
            (LoadFeedforward, "load_feedforward", {
                "append": True, "once_voltage_v": array.array("d", [-10.0])}),
            (LoadFeedback, "load_feedback", {"law": LAW}),
            (StartTracking, "start_tracking", {"ticks": 3})):
        service_type, name, fields = request
        response = stage.call(service_type, name, feedforward_id=own, **fields)
        assert not response.success
        assert response.message.startswith(f"{name} refused: {SENTENCE}")
    appended = stage.call(LoadFeedforward, "load_feedforward", append=True, feedforward_id=other,
                          once_voltage_v=array.array("d", np.full(40, -10.0)))
    assert appended.feedforward_id == other
    assert stage.call(StartTracking, "start_tracking", ticks=11, feedforward_id=other).success
    assert np.array_equal(played(stage), np.r_[OTHER_V, np.full(40, -10.0)])


def test_client_that_names_no_feedforward_plays_what_is_loaded(stage):
    assert stage.load(OWN_V).success and stage.load(OTHER_V).success
    assert stage.start_tracking(feedback=False, ticks=10).success
    assert np.array_equal(played(stage), OTHER_V)


@pytest.mark.parametrize("disturbed", [True, False])
def test_run_is_refused_where_another_client_loads_between_its_calls(stage, disturbed):
    tracker = StageTracker(stage.node)
    load = stage.node.create_client(LoadFeedforward, "load_feedforward")

    def other_loads():
        """Come between what the tracker loads and what it starts; stream nothing."""
        if disturbed:
            call_service(stage.node, load, LoadFeedforward.Request(
                once_voltage_v=array.array("d", OTHER_V)))
        return np.empty(0)

    def run():
        tracker.run(OWN_V, np.empty(0), 10, lambda block: 0.0, answering=True,
                    cancelled=lambda: False, report=lambda: None, more=other_loads)

    if disturbed:
        with pytest.raises(CallFailed, match=SENTENCE):
            stage.beside(run)
        assert not any(block.flags & SampleBlock.FLAG_TRACKING for block in stage.blocks)
    else:
        stage.beside(run)
        assert np.array_equal(played(stage), OWN_V)


def test_run_that_is_given_up_as_the_stage_falls_silent_is_stopped(stage, monkeypatch):
    monkeypatch.setattr(stage_tracking, "SILENCE_TIMEOUT_S", 0.5)
    tracker = StageTracker(stage.node)
    monkeypatch.setattr(tracker, "_publish", lambda tick, voltage_v: None)  # time stands still
    with pytest.raises(CallFailed, match="sent no samples for 0.5 s"):
        stage.beside(tracker.run, OWN_V, np.empty(0), 0, lambda block: 0.0, answering=True,
                     cancelled=lambda: False, report=lambda: None)
    assert stage.samples().voltage_v[-1] == 0.0
