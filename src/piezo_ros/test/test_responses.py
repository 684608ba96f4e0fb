# SPDX-License-Identifier: BSD-3-Clause
"""A response is sent until the client is known, and not for ever."""

import warnings

import pytest

from piezo_ros.responses import ATTEMPTS, RCLError, answered_again, sent_again


def warn_as_services_do():
    warnings.warn("failed to send response (timeout): client will not receive response",
                  RuntimeWarning, stacklevel=1)


def raise_as_actions_do():
    raise RCLError("failed to send goal response", "timeout")


@pytest.fixture(params=[(sent_again, warn_as_services_do), (answered_again, raise_as_actions_do)],
                ids=["service", "action"])
def send(request):
    """Send a response to a client that is not known in the first attempts; return these."""
    again, fail = request.param

    def send(attempts):
        sent = []

        def send_once(*arguments):
            sent.append(arguments)
            if len(sent) <= attempts:
                fail()

        again(send_once)("server", "first", "second")
        return sent

    return send


@pytest.mark.parametrize("attempts", [0, 1, 5])
def test_a_response_is_sent_until_the_client_is_known(send, attempts, recwarn):
    assert send(attempts) == [("server", "first", "second")] * (attempts + 1)
    assert not [each for each in recwarn if each.category is RuntimeWarning]


def test_a_client_that_never_comes_is_given_up_with_a_warning(send):
    with pytest.warns(RuntimeWarning, match="client will not receive"):
        assert len(send(1000)) == ATTEMPTS


def test_other_warnings_are_passed_on():
    def send(service, response, header):
        warnings.warn("something else", UserWarning, stacklevel=1)

    with pytest.warns(UserWarning, match="something else"):
        sent_again(send)("service", "response", "header")
