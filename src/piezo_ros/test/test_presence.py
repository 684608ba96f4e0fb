# SPDX-License-Identifier: BSD-3-Clause
"""A node that went away is missed, whoever bears its name afterwards."""

import time
from types import SimpleNamespace

import pytest
import rclpy

from piezo_ros import presence
from piezo_ros.leaving import leave
from piezo_ros.presence import ClientWatch, Presence

TIMEOUT_S = 300.0


@pytest.fixture
def contexts():
    """Make nodes, each of a context of its own as if of another process."""
    made = []

    def make(name):
        context = rclpy.Context()
        rclpy.init(context=context)
        made.append((context, rclpy.create_node(name, namespace="/presence", context=context)))
        return made[-1][1]

    yield make
    for context, _ in made:
        context.try_shutdown()


@pytest.fixture
def watcher(contexts):
    return contexts("watcher")


def until(condition):
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "it never happens"


def seen(watcher, name, count=1):
    """Wait until so many nodes of a name are seen."""
    until(lambda: [found for found, _ in watcher.get_node_names_and_namespaces()
                   ].count(name) == count
          and len(presence._identities(watcher, f"/presence/{name}")) == count)


def test_node_of_the_same_name_does_not_stand_for_one_that_is_gone(contexts, watcher, monkeypatch):
    monkeypatch.setattr(presence, "SETTLING_S", 0.0)
    first = contexts("mortal")
    seen(watcher, "mortal")
    watched = Presence(watcher, "/presence/mortal")
    assert not watched.gone
    contexts("mortal")
    seen(watcher, "mortal", 2)
    leave(first)
    until(lambda: watched.gone)
    assert not Presence(watcher, "/presence/mortal").gone


def test_successor_is_watched_anew_once_nobody_was_in_between(contexts, watcher):
    watch = ClientWatch(watcher)
    first = contexts("mortal")
    seen(watcher, "mortal")
    assert not watch.is_gone("/presence/mortal")
    assert not watch.is_gone("")
    leave(first)
    contexts("mortal")
    seen(watcher, "mortal")
    assert not watch.is_gone("/presence/mortal")


def test_node_that_never_appears_is_gone_after_a_while(watcher, monkeypatch):
    now_s = 0.0
    monkeypatch.setattr(presence, "time", SimpleNamespace(monotonic=lambda: now_s))
    watched = Presence(watcher, "/presence/nobody")
    now_s = presence.APPEARANCE_TIMEOUT_S
    assert not watched.gone
    now_s += 2.0 * presence.LOOK_PERIOD_S
    assert watched.gone


def test_nobody_is_never_gone(watcher):
    assert not Presence(watcher, "").gone


def test_node_is_known_from_the_beginning_however_late_it_is_looked_at(
        contexts, watcher, monkeypatch):
    monkeypatch.setattr(presence, "SETTLING_S", 0.0)
    monkeypatch.setattr(presence, "LOOK_PERIOD_S", 0.0)
    first = contexts("mortal")
    seen(watcher, "mortal")
    watched = Presence(watcher, "/presence/mortal")
    leave(first)
    seen(watcher, "mortal", 0)
    contexts("mortal")
    seen(watcher, "mortal")
    assert watched.gone


def test_node_whose_publishers_are_found_late_is_told_from_its_successor(monkeypatch):
    now_s, publishers = 0.0, []
    monkeypatch.setattr(presence, "time", SimpleNamespace(monotonic=lambda: now_s))
    graph = SimpleNamespace(
        get_node_names_and_namespaces=lambda: [("mortal", "/presence")],
        get_publishers_info_by_topic=lambda topic: [SimpleNamespace(
            node_name="mortal", node_namespace="/presence", endpoint_gid=[gid])
            for gid in publishers])
    watched = Presence(graph, "/presence/mortal")
    now_s += presence.SETTLING_S + presence.LOOK_PERIOD_S
    publishers = [1]
    assert not watched.gone
    now_s += 2.0 * presence.LOOK_PERIOD_S
    publishers = [2]
    assert watched.gone
