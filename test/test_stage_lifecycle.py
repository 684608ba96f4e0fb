# SPDX-License-Identifier: BSD-3-Clause
"""The stage moves only while its lifecycle says active."""

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from lifecycle_msgs.msg import Transition
from piezo_interfaces.msg import SampleBlock

from piezo_client.client import GoalFailed

FLAG_RAMPING = SampleBlock.FLAG_RAMPING


@pytest.fixture(scope="module")
def stage(nodes):
    return nodes.start(namespace="/unattended", connect=False, autostart=False)


def test_stage_refuses_everything_until_it_is_configured_and_activated(stage):
    for state, transition in [("unconfigured", Transition.TRANSITION_CONFIGURE),
                              ("inactive", Transition.TRANSITION_ACTIVATE)]:
        assert stage.state() == state
        with pytest.raises(GoalFailed, match="the stage is not active: activate it first"):
            stage.play([1.0])
        for response in (stage.load([1.0]), stage.start_tracking(False),
                         stage.trigger("stop_tracking")):
            assert not response.success
            assert response.message.endswith("the stage is not active: activate it first")
        assert stage.trigger("emergency_stop").success
        assert stage.change_state(transition)
    assert stage.state() == "active"
    # The stop of before holds on.
    with pytest.raises(GoalFailed, match=r"the stage is stopped \(emergency stop\): reset it"):
        stage.play([1.0])
    assert stage.trigger("reset").success
    stage.connect()
    assert stage.play(np.full(40, 10.0)).success


def test_deactivation_in_the_middle_of_a_waveform_ramps_to_rest_and_tells_the_client(stage):
    stage.forget()
    goal = stage.begin_play(np.full(4000, 60.0), repeats=1_000_000)
    assert stage.change_state(Transition.TRANSITION_DEACTIVATE)
    status, result = stage.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "the stage was deactivated"
    samples = stage.samples(result.last_sample)
    assert samples.gapless
    assert samples.voltage_v[-1] == 0.0
    assert len(samples.flagged(FLAG_RAMPING)) == 2 * 1200  # 60 V at 2000 V/s
    with pytest.raises(GoalFailed, match="the stage is not active"):
        stage.play([1.0])


def test_stage_starts_anew_at_sample_0_when_it_is_activated_again(stage):
    assert stage.change_state(Transition.TRANSITION_ACTIVATE)
    stage.forget()
    result = stage.play([0.0])
    assert result.first_sample == 0
    assert stage.samples(result.last_sample).first_sample == 0


def test_stage_can_be_cleaned_up_and_configured_again(stage):
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP,
                       Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        assert stage.change_state(transition)
    assert stage.play(np.full(40, 10.0)).success


def test_shutdown_in_the_middle_of_tracking_ramps_to_rest(stage):
    stage.forget()
    assert stage.load(np.linspace(0, 60, 400)).success
    assert stage.start_tracking(feedback=False).success
    stage.until(lambda: stage.blocks and stage.blocks[-1].voltage_v[-1] == 60.0)
    assert stage.change_state(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    stage.until(lambda: stage.blocks[-1].voltage_v[-1] == 0.0)
    assert stage.state() == "finalized"
