# SPDX-License-Identifier: BSD-3-Clause
"""Get limits, clock and rates from the stage itself."""

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

# Parameters that other nodes had before the stage described itself. Files may still set them for
# all nodes, but only to the values of the stage.
OF_THE_STAGE = ("sample_rate_hz", "samples_per_tick", "minimum_voltage_v", "maximum_voltage_v",
                "rest_voltage_v", "slew_limit_v_per_s")
# Largest time in s from the start of a stage's node to its discovery.
APPEARANCE_S = 10.0
POLL_S = 0.05


class DescribedStage:
    """The stage of a node's namespace, as it describes itself.

    Its topic is the full name of that of the description; the function is called with each of them.
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
        """Present description of the stage; None without a configured stage."""
        heard, present = self._heard, self._present()
        self._publishers = self._publishers or present
        return heard if self._publishers & present else None

    @property
    def contradiction(self) -> str:
        """Parameters of this node that contradict the stage; empty if there are none."""
        return "; ".join(
            f"parameter {name} is {value}, but {self.topic} publishes {published}: "
            "set it at the stage alone"
            for name, value in self._given.items()
            if self._heard is not None and value != (published := getattr(self._heard, name)))

    @property
    def too_many_axes(self) -> str:
        """Why a stage cannot be used for what takes one axis; empty if it can."""
        axes = self._heard.axes if self._heard is not None else []
        if not axes:
            return ""
        return (f"{self._node.get_name()} does this for a stage of one axis, this one has the "
                f"axes {', '.join(axis.name for axis in axes)}: record experiments or scans of all "
                "of them, and give the recordings to ./run piezo_identification identify or "
                "diagnose")

    def wait(self, check: Callable[[], None], several_axes: bool = False) -> StageDescription:
        """Return the description of the stage; wait for one that is starting.

        The check is called periodically, and ends the wait by an exception. A stage of several axes
        must be allowed for. Raises `CallFailed` if there is no stage, it is not configured or has
        too many axes, or a parameter contradicts it.
        """
        begin_s, asked_s, state = time.monotonic(), -math.inf, None
        waiting = Waiting(self._node, self._state.srv_name)
        while (description := self.description) is None:
            check()
            now_s = time.monotonic()
            waiting.look(now_s - begin_s)
            if not self._state.service_is_ready():
                asked_s, state = -math.inf, None  # the previous server is gone
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
        """Raise `CallFailed` if the stage is gone, or its description has changed since."""
        present = self.description
        if present is None:
            raise CallFailed(f"the stage that {self.topic} described is gone: start it again")
        changes = [f"{name} from {before} to {now}"
                   for name in description.get_fields_and_field_types()
                   if (before := getattr(description, name)) != (now := getattr(present, name))]
        if changes:
            raise CallFailed(f"the stage was restarted meanwhile with {', '.join(changes)}: "
                             "send the goal again")

    def _check_start(self, state: Future | None, waited_s: float) -> None:
        """Raise CallFailed if it is pointless to wait longer for a description."""
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
        """Return the identities of the present publishers; a restarted stage has a new one."""
        return {bytes(publisher.endpoint_gid)
                for publisher in self._node.get_publishers_info_by_topic(self.topic)}


def _given_parameter(node: Node, name: str) -> object:
    """Return the given value of a parameter that the node does not declare; None without one."""
    value = node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    return value
