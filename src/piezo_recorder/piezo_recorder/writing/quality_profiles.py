# SPDX-License-Identifier: BSD-3-Clause
"""Qualities of service of recorded topics in the form that rosbag2 replays them from."""

from collections.abc import Iterable
from typing import Any

import yaml

NANOSECONDS = 1_000_000_000
POLICIES = ("reliability", "durability")
DURATIONS = ("deadline", "lifespan")


def offered_profile(quality: Any) -> dict[str, Any]:
    """Return the entry of ``offered_qos_profiles`` for what a publisher offers.

    Parameters
    ----------
    quality : rclpy.qos.QoSProfile
        As the graph tells it; it does not tell the history, which is then ``unknown``.

    Returns
    -------
    dict
        As rosbag2 writes it since version 9 of its metadata.
    """
    return {
        "history": quality.history.short_key,
        "depth": quality.depth,
        **{name: getattr(quality, name).short_key for name in POLICIES},
        **{name: _duration(getattr(quality, name)) for name in DURATIONS},
        "liveliness": quality.liveliness.short_key,
        "liveliness_lease_duration": _duration(quality.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": quality.avoid_ros_namespace_conventions,
    }


def profiles_to_text(profiles: Iterable[dict[str, Any]]) -> str:
    """Return the YAML text of a list of profiles, as a channel of an MCAP file bears it."""
    return yaml.safe_dump(list(profiles), sort_keys=False)


def profiles_from_text(text: str) -> list[dict[str, Any]]:
    """Return the profiles of a channel's YAML text; none where it has none or is damaged."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def _duration(duration: Any) -> dict[str, int]:
    return {"sec": duration.nanoseconds // NANOSECONDS, "nsec": duration.nanoseconds % NANOSECONDS}
