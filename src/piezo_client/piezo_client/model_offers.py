# SPDX-License-Identifier: BSD-3-Clause
"""What the monitor offers, and the acceptance of it."""

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
"""In which what a node told before is heard."""


def monitor_follows(client: Client, from_s: float, to_s: float, wait_s: float) -> bool:
    """Tell whether the monitor has watched the stage up to a time of its sample clock.

    Parameters
    ----------
    from_s, to_s : float
        Between which the time lies: the monitor may still watch a stage before, whose clock is
        another.
    wait_s : float
        How long to wait for the monitor to tell so.
    """
    told_s: list[float] = []

    def hear(message: DiagnosticArray) -> None:
        told_s.extend(float(entry.value) for status in message.status for entry in status.values
                      if entry.key == "watched_until_s")

    subscription = client.node.create_subscription(
        DiagnosticArray, "/diagnostics", hear, DIAGNOSTICS_DEPTH)
    try:
        return client.spin_until(lambda: bool(told_s) and from_s <= told_s[-1] < to_s, wait_s)
    finally:
        client.node.destroy_subscription(subscription)


def offered_model(client: Client, wait_s: float = LATCHED_S) -> OfferedModel | None:
    """Return what the monitor has offered last.

    Parameters
    ----------
    wait_s : float
        How long to wait for an offer.

    Returns
    -------
    OfferedModel or None
        None where there is no offer.
    """
    heard: list[ExtendedModel] = []
    subscription = client.node.create_subscription(
        ExtendedModel, "monitor/extended_model", heard.append, DESCRIPTION)
    try:
        client.spin_until(lambda: bool(heard), wait_s)
    finally:
        client.node.destroy_subscription(subscription)
    if not heard:
        return None
    offer = heard[-1]
    return OfferedModel(Path(offer.extended_model), Path(offer.model), offer.sentence,
                        offer.since_s, offer.before_rms_um, offer.after_rms_um)


def accept_extended_model(client: Client, model: AnyPath, extended_model: AnyPath) -> str:
    """Have the controller use an extended model in place of a model, from now on.

    Parameters
    ----------
    model : path-like
        That goals name.
    extended_model : path-like
        Empty to use the model itself again.

    Returns
    -------
    str
        What is used from now on.

    Raises
    ------
    GoalFailed
        If the controller refuses it.
    """
    response = client.call(
        AcceptExtendedModel, SERVICE, model=model, extended_model=extended_model)
    if not response.success:
        raise GoalFailed(SERVICE, response)
    return response.message
