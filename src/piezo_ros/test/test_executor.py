# SPDX-License-Identifier: BSD-3-Clause
"""What a callback raises reaches who spins; the process goes on."""

import pytest
import rclpy
from std_srvs.srv import Trigger

from piezo_ros.executor import make_executor, spin_once
from piezo_ros.leaving import leave


@pytest.fixture
def spun():
    """A node of its own context, and its executor."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("spun", context=context)
    executor = make_executor(context)
    executor.add_node(node)
    yield node, executor
    executor.remove_node(node)
    executor.shutdown()
    leave(node)


def raise_plainly(*_):
    raise ValueError("of the callback")


async def raise_later():
    raise ValueError("of the callback")


@pytest.mark.parametrize("work", [raise_plainly, raise_later])
def test_what_a_task_raises_is_raised_once_and_the_next_one_runs(spun, work):
    _, executor = spun
    done = []
    executor.create_task(work)
    with pytest.raises(ValueError, match="of the callback"):
        while True:
            spin_once(executor, 0.05)
    executor.create_task(done.append, 1)
    while not done:
        spin_once(executor, 0.05)


def test_what_a_service_raises_is_raised(spun):
    node, executor = spun
    node.create_service(Trigger, "raises", raise_plainly)
    client = node.create_client(Trigger, "raises")
    while not client.service_is_ready():
        spin_once(executor, 0.05)
    client.call_async(Trigger.Request())
    with pytest.raises(ValueError, match="of the callback"):
        while True:
            spin_once(executor, 0.05)
