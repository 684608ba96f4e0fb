# SPDX-License-Identifier: BSD-3-Clause
"""The work on a goal ends in order, also when its node has ended before it."""

import threading

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from piezo_interfaces.action import Track
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode

from piezo_ros.requests.goals import GoalServers
from piezo_ros.requests.lost_answers import PatientActionClient

TIMEOUT_S = 300.0


@pytest.fixture
def node():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = LifecycleNode("works", context=context)
    yield node
    rclpy.shutdown(context=context)


def test_work_that_outlives_its_node_ends_without_a_word(node, capfd):
    begun, ended = threading.Event(), threading.Event()
    threads = []

    def work(goal, result, progress):
        threads.append(threading.current_thread())
        begun.set()
        assert ended.wait(TIMEOUT_S)
        node.get_publishers_info_by_topic("/parameter_events")

    servers = GoalServers(node)
    servers.serve(Track, "work", work)
    node.trigger_configure()
    node.trigger_activate()
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    client = ActionClient(node, Track, "work")
    sent = client.send_goal_async(Track.Goal())
    executor.spin_until_future_complete(sent, TIMEOUT_S)
    assert sent.result().accepted
    assert begun.wait(TIMEOUT_S)
    executor.remove_node(node)
    node.destroy_node()
    ended.set()
    threads[0].join(TIMEOUT_S)
    assert not threads[0].is_alive()
    assert "Traceback" not in capfd.readouterr().err


def test_result_that_was_lost_is_asked_for_again(node):
    executor = SingleThreadedExecutor(context=node.context)
    ended = threading.Event()
    servers = GoalServers(node)
    servers.serve(Track, "work", lambda goal, result, progress: ended.wait(TIMEOUT_S))
    node.trigger_configure()
    node.trigger_activate()
    executor.add_node(node)
    client = PatientActionClient(node, Track, "work")
    sent = client.send_goal_async(Track.Goal())
    executor.spin_until_future_complete(sent, TIMEOUT_S)
    result = sent.result().get_result_async()
    client._pending_result_requests.clear()  # as if no response ever came
    client.ask_again()
    assert not client._pending_result_requests  # the goal has not ended
    ended.set()
    for _ in range(int(TIMEOUT_S)):
        executor.spin_until_future_complete(result, 1.0)
        if result.done():
            break
        client.ask_again()
    assert result.result().status == GoalStatus.STATUS_SUCCEEDED
