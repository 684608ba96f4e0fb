# SPDX-License-Identifier: BSD-3-Clause
"""Take limits, clock and rates from the stage that has them."""

import math
import time
from collections.abc import Callable

from lifecycle_msgs.srv import GetState
from piezo_interfaces.msg import StageDescription
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.task import Future

from piezo_ros.quality import DESCRIPTION
from piezo_ros.requests.calls import CALL_TIMEOUT_S, RESEND_S, CallFailed
from piezo_ros.requests.servers import Waiting

# Parameters that other nodes had, too, before the stage described itself. Files may still set
# them for all nodes; they must then say the same.
OF_THE_STAGE = ("sample_rate_hz", "samples_per_tick", "minimum_voltage_v", "maximum_voltage_v",
                "rest_voltage_v", "slew_limit_v_per_s")
# What the node of a stage that has just been started may take to be seen.
APPEARANCE_S = 10.0
POLL_S = 0.05


class DescribedStage:
    """The stage of a node's namespace, as it describes itself.

    Parameters
    ----------
    on_change : callable, optional
        Takes each `StageDescription` as it comes.

    Attributes
    ----------
    topic : str
        On which the stage describes itself; its full name.
    """

    def __init__(self, node: Node,
                 on_change: Callable[[StageDescription], None] = lambda description: None) -> None:
        self._node, self._on_change = node, on_change
        self._given = {name: value for name in OF_THE_STAGE
                       if (value := _given_parameter(node, name)) is not None}
        self._heard: StageDescription | None = None
        self._publishers: set[bytes] = set()
        self._state = node.create_client(GetState, "stage/get_state")
        self.topic: str = node.create_subscription(
            StageDescription, "stage/description", self._take, DESCRIPTION).topic_name

    @property
    def description(self) -> StageDescription | None:
        """What the stage says of itself; None while there is no stage that is configured."""
        heard, present = self._heard, self._present()
        self._publishers = self._publishers or present
        return heard if self._publishers & present else None

    @property
    def contradiction(self) -> str:
        """Which parameters of this node contradict the stage; empty where none does."""
        return "; ".join(
            f"parameter {name} is {value}, but {self.topic} says {told}: set it at the stage alone"
            for name, value in self._given.items()
            if self._heard is not None and value != (told := getattr(self._heard, name)))

    @property
    def too_many_axes(self) -> str:
        """Why a node that takes one axis cannot use the stage; empty where it can."""
        axes = self._heard.axes if self._heard is not None else []
        if not axes:
            return ""
        return (f"{self._node.get_name()} takes a stage of one axis, this one has the axes "
                f"{', '.join(axis.name for axis in axes)}: play and record waveforms of all of "
                "them, and identify from the recordings")

    def wait(self, check: Callable[[], None], several_axes: bool = False) -> StageDescription:
        """Return what the stage says of itself; wait for one that has just been started.

        Parameters
        ----------
        check : callable
            Called now and then; ends the wait by an exception.
        several_axes : bool
            Whether a stage of several axes will do, which is refused otherwise.

        Raises
        ------
        CallFailed
            If nobody serves the stage, it is not configured or has too many axes, or a parameter
            contradicts it.
        """
        begin_s, asked_s, state = time.monotonic(), -math.inf, None
        waiting = Waiting(self._node, self._state.srv_name)
        while (description := self.description) is None:
            check()
            now_s = time.monotonic()
            waiting.look(now_s - begin_s)
            if not self._state.service_is_ready():
                asked_s, state = -math.inf, None  # whoever was asked is gone
            elif now_s - asked_s > RESEND_S and not (state and state.done()):
                asked_s, state = now_s, self._state.call_async(GetState.Request())
            self._check_start(state, now_s - begin_s)
            time.sleep(POLL_S)
        if self.contradiction:
            raise CallFailed(self.contradiction)
        if self.too_many_axes and not several_axes:
            raise CallFailed(self.too_many_axes)
        return description

    def check_unchanged(self, description: StageDescription) -> None:
        """Refuse to play what was planned for a stage that has been replaced meanwhile.

        Parameters
        ----------
        description : StageDescription
            Of the stage that it was planned for.

        Raises
        ------
        CallFailed
        """
        present = self.description
        if present is None:
            raise CallFailed(f"the stage that {self.topic} described is gone: start it again")
        changes = [f"{name} from {before} to {now}"
                   for name in description.get_fields_and_field_types()
                   if (before := getattr(description, name)) != (now := getattr(present, name))]
        if changes:
            raise CallFailed(f"the stage was started anew meanwhile with {', '.join(changes)}: "
                             "send the goal again")

    def _check_start(self, state: Future | None, waited_s: float) -> None:
        """Raise CallFailed where there is no reason to wait for a description any longer."""
        if state is None and waited_s > APPEARANCE_S:
            raise CallFailed(f"nobody serves the stage on {self.topic}: start its node")
        if state is not None and state.done():
            label = state.result().current_state.label
            if label in ("unconfigured", "finalized"):
                raise CallFailed(f"the stage is {label}: configure and activate it first")
        if waited_s > CALL_TIMEOUT_S:
            raise CallFailed(f"the stage did not describe itself on {self.topic} within "
                             f"{CALL_TIMEOUT_S:g} s: look at its node's log")

    def _take(self, description: StageDescription) -> None:
        self._publishers, self._heard = self._present(), description
        if self.contradiction:
            self._node.get_logger().error(self.contradiction)
        self._on_change(description)

    def _present(self) -> set[bytes]:
        """Identities of those who describe the stage now; one started anew has another."""
        return {bytes(publisher.endpoint_gid)
                for publisher in self._node.get_publishers_info_by_topic(self.topic)}


def _given_parameter(node: Node, name: str) -> object:
    """Return what a parameter was set to that the node does not have; None if it was not."""
    value = node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    return value
