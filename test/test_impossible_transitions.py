# SPDX-License-Identifier: BSD-3-Clause
"""A transition that the present state does not have is refused, and the node lives on."""

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState

from piezo_bringup.processes import EXECUTABLES


@pytest.mark.parametrize("node", EXECUTABLES)
@pytest.mark.parametrize("transition", [
    Transition(id=Transition.TRANSITION_ACTIVATE), Transition(id=200),
    Transition(label="configure")], ids=["activate", "unknown", "by label"])
def test_impossible_transition_is_answered_with_false_and_the_node_stays_active(
        serving, node, transition):
    suite = serving(node)
    assert not suite.call(ChangeState, f"{node}/change_state", transition=transition).success
    assert suite.call(GetState, f"{node}/get_state").current_state.label == "active"
