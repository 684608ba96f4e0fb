# SPDX-License-Identifier: BSD-3-Clause
"""Responses of services that also reach clients that the middleware has just discovered."""

import functools
import warnings
from collections.abc import Callable

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.service import Service

from piezo_ros.messages import Message

RCLError = rclpy_implementation.RCLError

NOT_SENT = "failed to send response"
ATTEMPTS = 20
"""Attempts to send; each waits up to 0.1 s in the middleware for the discovery of the client."""


Send = Callable[[Service, Message, Message], None]
"""Function that sends a response of a service, given the header of the request."""


def sent_again(send: Send) -> Send:
    """Return a function that repeats sending a response until the middleware knows the client.

    rclpy sends once and warns that the client will not receive it; the client then waits for ever.
    The function given is like `rclpy.service.Service.send_response`.
    """
    @functools.wraps(send)
    def patient(service: Service, response: Message, header: Message) -> None:
        for _ in range(ATTEMPTS):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                send(service, response, header)
            if not any(NOT_SENT in str(warning.message) for warning in caught):
                break
        for warning in caught:
            warnings.warn(warning.message, stacklevel=2)

    return patient


def answered_again(send: Callable[..., None]) -> Callable[..., None]:
    """Return a function that repeats a response of an action until the middleware knows the client.

    rclpy would not start a goal whose acceptance could not be sent. Here it starts, and the status
    of the action informs the client. The function given is a ``send_..._response`` of the action
    servers underlying those of rclpy.
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
    """Make all services and actions of this process repeat a response until it can be sent."""
    if hasattr(Service.send_response, "__wrapped__"):
        return
    # rclpy has no other hooks at which a response can be repeated.
    Service.send_response = sent_again(  # type: ignore[method-assign, assignment]
        Service.send_response)
    servers = rclpy_implementation.ActionServer
    for name in ("send_goal_response", "send_cancel_response", "send_result_response"):
        setattr(servers, name, answered_again(getattr(servers, name)))
