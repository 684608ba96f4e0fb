# SPDX-License-Identifier: BSD-3-Clause
"""A node that leaves hears of no other node any more, so that nothing waits for what it hears."""

import pytest
import rclpy
from piezo_interfaces.msg import SampleBlock

from piezo_ros import leaving
from piezo_ros.leaving import leave


@pytest.fixture
def new_node(domain_of_our_own):
    """Makes nodes with contexts of their own, each of which publishes a topic of its name."""
    def make(name):
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node(name, context=context)
        node.create_publisher(SampleBlock, name, 1)
        return node

    return make


def until_seen(name, by):
    while by.count_publishers(name) == 0:
        pass


def test_node_that_leaves_hears_of_no_other_node(new_node):
    node, early = new_node("leaving"), new_node("early")
    until_seen("early", by=node)
    leaving._end_discovery(node)
    late = new_node("late")
    until_seen("late", by=early)
    until_seen("leaving", by=late)
    assert node.count_publishers("late") == 0
    for each in early, late, node:
        leave(each)
        assert not each.context.ok()
        leave(each)


@pytest.mark.parametrize("error", [OSError, AttributeError])
def test_node_of_another_middleware_or_version_leaves_as_usual(new_node, monkeypatch, error):
    def without(*_):
        raise error

    node = new_node("other")
    leaving._fast_dds.cache_clear()
    monkeypatch.setattr(leaving.ctypes, "CDLL", without)
    leave(node)
    assert not node.context.ok()
    leaving._fast_dds.cache_clear()
