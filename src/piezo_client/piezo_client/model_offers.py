# SPDX-License-Identifier: BSD-3-Clause
"""The extended model that the monitor offers, and its acceptance."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from piezo_interfaces.msg import ExtendedModel
from piezo_interfaces.srv import AcceptExtendedModel

from piezo_client.client import Client, GoalFailed
from piezo_client.paths import AnyPath
from piezo_client.results import OfferedModel
from piezo_ros.quality import DESCRIPTION, DIAGNOSTICS_DEPTH

SERVICE = "controller/accept_extended_model"
LATCHED_S = 2.0
"""Time in s within which a latched message arrives."""


def monitor_follows(client: Client, from_s: float, to_s: float, wait_s: float) -> bool:
    """Return whether the monitor has processed the stage up to a time of its sample clock (s).

    The time must lie in an interval: the monitor may still follow a previous stage, which has
    another clock. Its report is waited for some seconds.
    """
    def follows(messages: list[DiagnosticArray]) -> bool:
        until_s = [float(entry.value) for message in messages for status in message.status
                   for entry in status.values if entry.key == "watched_until_s"]
        return bool(until_s) and from_s <= until_s[-1] < to_s

    return follows(client.heard(
        DiagnosticArray, "/diagnostics", DIAGNOSTICS_DEPTH, follows, wait_s))


def offered_model(client: Client, wait_s: float = LATCHED_S) -> OfferedModel | None:
    """Return the last model that the monitor has offered; see `Stage.offered_model`."""
    heard = client.heard(ExtendedModel, "monitor/extended_model", DESCRIPTION, bool, wait_s)
    if not heard:
        return None
    offer = heard[-1]
    return OfferedModel(Path(offer.extended_model), Path(offer.model), offer.sentence,
                        offer.since_s, offer.before_rms_um, offer.after_rms_um)


def accept_extended_model(client: Client, model: AnyPath, extended_model: AnyPath) -> str:
    """Make the controller use an extended model; see `Stage.accept_extended_model`.

    Raises `GoalFailed` if the controller rejects it.
    """
    response = client.call(
        AcceptExtendedModel, SERVICE, model=model, extended_model=extended_model)
    if not response.success:
        raise GoalFailed(SERVICE, response)
    return response.message
