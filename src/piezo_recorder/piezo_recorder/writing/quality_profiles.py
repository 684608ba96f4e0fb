# SPDX-License-Identifier: BSD-3-Clause
"""Quality of service of recorded topics, in the form that rosbag2 replays."""

from collections.abc import Iterable
from typing import Any

import yaml

from piezo_recorder.writing.yaml_text import to_yaml

NANOSECONDS = 1_000_000_000
POLICIES = ("reliability", "durability")
DURATIONS = ("deadline", "lifespan")


def offered_profile(quality: Any) -> dict[str, Any]:
    """Return the entry of ``offered_qos_profiles``, as of version 9, for a publisher's quality.

    The graph does not report the history, which is ``unknown``.
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
    """Return the YAML text of a list of profiles for a channel of an MCAP file."""
    return to_yaml(list(profiles))


def profiles_from_text(text: str) -> list[dict[str, Any]]:
    """Return the profiles in a channel's YAML text; empty if there are none or it is damaged."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def _duration(duration: Any) -> dict[str, int]:
    return {"sec": duration.nanoseconds // NANOSECONDS, "nsec": duration.nanoseconds % NANOSECONDS}
