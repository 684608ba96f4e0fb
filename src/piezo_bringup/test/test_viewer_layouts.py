# SPDX-License-Identifier: BSD-3-Clause
"""The layouts for PlotJuggler and Foxglove show fields of messages that the nodes publish."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

SOURCE = Path(__file__).parents[2]
CONFIG = SOURCE / "piezo_bringup" / "config"
PUBLISHED = re.compile(r"create_publisher\(\s*(\w+), \"([\w/]+)\"")


def published_types():
    """Return the message type of every topic that a node publishes, under the namespace /."""
    found = {}
    for path in SOURCE.glob("piezo_*/piezo_*/**/*.py"):
        for message, topic in PUBLISHED.findall(path.read_text()):
            found["/" + topic.lstrip("/")] = message
    return found


def fields(message):
    """Return the type of every field of one of our messages, as in its definition."""
    text = (SOURCE / "piezo_interfaces" / "msg" / f"{message}.msg").read_text()
    return {name: kind for kind, name in re.findall(r"^([\w/\[\]]+) +(\w+) *(?:#|$)", text, re.M)}


def plotjuggler_curves():
    for curve in ElementTree.parse(CONFIG / "plotjuggler.xml").iter("curve"):
        names = [curve.get("curve_x"), curve.get("curve_y")] if curve.get("curve_x") else [
            curve.get("name")]
        for name in names:
            topic, field = name.rsplit("/", 1)
            yield topic, field


def foxglove_panels():
    return json.loads((CONFIG / "foxglove.json").read_text())


def foxglove_curves():
    for panel in foxglove_panels()["configById"].values():
        paths = [*panel.get("paths", []), *filter(None, [panel.get("xAxisPath")])]
        for path in paths:
            yield path["value"].split(".", 1)


@pytest.mark.parametrize("curves", [plotjuggler_curves, foxglove_curves])
def test_every_curve_is_a_number_that_a_node_publishes(curves):
    types = published_types()
    shown = list(curves())
    assert len(shown) >= 4
    for topic, field in shown:
        assert topic in types, f"nobody publishes {topic}"
        name, index = re.fullmatch(r"(\w+)(\[\d+\]|\[:\])?", field).groups()
        kind = fields(types[topic])[name]
        assert kind.endswith("[]") == (index is not None), f"{topic}.{field} is a {kind}"
        assert re.fullmatch(r"(float|u?int)\d+(\[\])?", kind)


def test_foxglove_places_every_panel_once():
    def names(part):
        return [part] if isinstance(part, str) else names(part["first"]) + names(part["second"])

    layout = foxglove_panels()
    assert sorted(names(layout["layout"])) == sorted(layout["configById"])
    topics = {panel["topicToRender"] for panel in layout["configById"].values()
              if "topicToRender" in panel}
    assert topics <= published_types().keys()
