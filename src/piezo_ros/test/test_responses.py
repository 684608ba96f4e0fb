# SPDX-License-Identifier: BSD-3-Clause
"""A response is sent until the client is known, and not for ever."""

import warnings

import pytest

from piezo_ros.responses import ATTEMPTS, RCLError, answered_again, sent_again

WARNING = "failed to send response (timeout): client will not receive response"


def service_that_is_not_ready(attempts):
    sent = []

    def send(service, response, header):
        sent.append((service, response, header))
        if len(sent) <= attempts:
            warnings.warn(WARNING, RuntimeWarning, stacklevel=1)

    return sent, send


@pytest.mark.parametrize("attempts", [0, 1, 5])
def test_a_response_is_sent_until_the_client_is_known(attempts, recwarn):
    sent, send = service_that_is_not_ready(attempts)
    sent_again(send)("service", "response", "header")
    assert sent == [("service", "response", "header")] * (attempts + 1)
    assert not [each for each in recwarn if each.category is RuntimeWarning]


def test_a_client_that_never_comes_is_given_up_with_the_warning():
    sent, send = service_that_is_not_ready(1000)
    with pytest.warns(RuntimeWarning, match="client will not receive response"):
        sent_again(send)("service", "response", "header")
    assert len(sent) == ATTEMPTS


def test_other_warnings_are_passed_on():
    def send(service, response, header):
        warnings.warn("something else", UserWarning, stacklevel=1)

    with pytest.warns(UserWarning, match="something else"):
        sent_again(send)("service", "response", "header")


def server_that_is_not_ready(attempts):
    sent = []

    def send(server, header, response):
        sent.append((server, header, response))
        if len(sent) <= attempts:
            raise RCLError("Failed to send goal response", "client will not receive response")

    return sent, send


@pytest.mark.parametrize("attempts", [0, 1, 5])
def test_an_answer_for_an_action_is_sent_until_the_client_is_known(attempts, recwarn):
    sent, send = server_that_is_not_ready(attempts)
    answered_again(send)("server", "header", "response")
    assert sent == [("server", "header", "response")] * (attempts + 1)
    assert not [each for each in recwarn if each.category is RuntimeWarning]


def test_a_goal_whose_answer_reaches_nobody_goes_on_with_a_warning():
    sent, send = server_that_is_not_ready(1000)
    with pytest.warns(RuntimeWarning, match="the client will not receive it"):
        answered_again(send)("server", "header", "response")
    assert len(sent) == ATTEMPTS
