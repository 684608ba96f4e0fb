# SPDX-License-Identifier: BSD-3-Clause
"""Responses of services that reach clients whom the middleware has only just met."""

import functools
import warnings
from collections.abc import Callable

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.service import Service

from piezo_ros.messages import Message

RCLError = rclpy_implementation.RCLError

NOT_SENT = "failed to send response"
ATTEMPTS = 20
"""Each waits up to 0.1 s in the middleware for the client's end to be known."""


Send = Callable[[Service, Message, Message], None]
"""Sends a response of a service, given the header of the request."""


def sent_again(send: Send) -> Send:
    """Return what sends a response again while the middleware does not know the client.

    rclpy sends once and warns that the client will not receive it; the client waits for ever.

    Parameters
    ----------
    send : callable
        As `rclpy.service.Service.send_response`.

    Returns
    -------
    callable
        To be used in its place.
    """
    @functools.wraps(send)
    def patient(service: Service, response: Message, header: Message) -> None:
        for _ in range(ATTEMPTS):
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                send(service, response, header)
            if not any(NOT_SENT in str(warning.message) for warning in told):
                break
        for warning in told:
            warnings.warn(warning.message, stacklevel=2)

    return patient


def answered_again(send: Callable[..., None]) -> Callable[..., None]:
    """Return what answers for an action again while the middleware does not know the client.

    rclpy would not begin a goal whose acceptance could not be sent: it is begun here, and the
    action's status tells the client.

    Parameters
    ----------
    send : callable
        As a ``send_..._response`` of the action servers that are under those of rclpy.

    Returns
    -------
    callable
        To be used in its place.
    """
    @functools.wraps(send)
    def patient(server: object, header: Message, response: Message) -> None:
        failure = None
        for _ in range(ATTEMPTS):
            try:
                return send(server, header, response)
            except RCLError as error:
                failure = error
        warnings.warn(f"{failure}: the client will not receive it", RuntimeWarning, stacklevel=2)

    return patient


def answer_patiently() -> None:
    """Make every service and action of this process send a response until it is received."""
    if hasattr(Service.send_response, "__wrapped__"):
        return
    # rclpy offers no other places at which a response can be sent again.
    Service.send_response = sent_again(  # type: ignore[method-assign, assignment]
        Service.send_response)
    servers = rclpy_implementation.ActionServer
    for name in ("send_goal_response", "send_cancel_response", "send_result_response"):
        setattr(servers, name, answered_again(getattr(servers, name)))
