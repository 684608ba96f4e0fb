# SPDX-License-Identifier: BSD-3-Clause
"""Definitions of installed ROS message types, as embedded in a recording."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

try:
    from ament_index_python import PackageNotFoundError, get_package_share_directory
except ImportError:  # without ROS no package of messages is installed
    class PackageNotFoundError(KeyError):  # type: ignore[no-redef]
        """The package is not installed."""

    def get_package_share_directory(  # type: ignore[misc]
            package_name: str, print_warning: bool = True) -> str:
        """Raise, as the package is not installed."""
        raise PackageNotFoundError(package_name)

from piezo_recorder.sample_block import TYPE_NAME

SEPARATOR = "\n" + "=" * 80 + "\n"
PRIMITIVES = re.compile(
    r"(bool|byte|char|w?string(<=\d+)?|float32|float64|u?int(8|16|32|64))$")
PACKAGED = Path(__file__).with_name("sample_block.json")
"""Definition of the suite's own sample block, the same as installed with ROS."""


@dataclass(frozen=True)
class MessageDefinition:
    """Information that a reader needs to decode a type that is not installed."""

    type_name: str
    """Name, for instance ``std_msgs/msg/Header``."""
    text: str
    """The ``.msg`` file followed by those of every type it uses (schema encoding ``ros2msg``)."""
    type_hash: str = ""
    """RIHS01 hash of the type; empty if it is unknown."""


def installed_definition(type_name: str) -> MessageDefinition:
    """Return the definition of an installed message type; the sample block needs no ROS.

    ValueError is raised if the name has another form, or the type is not installed.
    """
    if type_name == TYPE_NAME and not _is_installed(type_name.split("/")[0]):
        return _packaged_definition()
    texts: dict[str, str] = {}
    _collect(type_name, texts)
    dependencies = [
        f"MSG: {name.replace('/msg/', '/')}\n{text}"
        for name, text in texts.items() if name != type_name]
    return MessageDefinition(
        type_name, SEPARATOR.join([texts[type_name], *dependencies]), _type_hash(type_name))


def _packaged_definition() -> MessageDefinition:
    return MessageDefinition(**json.loads(PACKAGED.read_text(encoding="utf-8")))


def _is_installed(package: str) -> bool:
    try:
        get_package_share_directory(package)
    except (PackageNotFoundError, OSError):
        return False
    return True


def _collect(type_name: str, texts: dict[str, str]) -> None:
    if type_name in texts:
        return
    texts[type_name] = _interface_file(type_name, ".msg").read_text(encoding="utf-8")
    package = type_name.split("/")[0]
    for used in _used_types(texts[type_name], package):
        _collect(used, texts)


def _used_types(text: str, package: str) -> Iterator[str]:
    """Yield the full names of the message types of a definition's fields."""
    for line in text.splitlines():
        fields = line.split("#")[0].split()
        if not fields:
            continue
        field_type = re.sub(r"\[.*\]$", "", fields[0])
        if PRIMITIVES.match(field_type):
            continue
        parts = field_type.split("/")
        yield f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}"


def _type_hash(type_name: str) -> str:
    description = _interface_file(type_name, ".json")
    hashes = json.loads(description.read_text(encoding="utf-8"))["type_hashes"]
    return next(entry["hash_string"] for entry in hashes if entry["type_name"] == type_name)


def _interface_file(type_name: str, suffix: str) -> Path:
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise ValueError(f"'{type_name}' is no message type: write it as 'std_msgs/msg/Header'.")
    try:
        share = get_package_share_directory(parts[0])
    except (PackageNotFoundError, OSError):
        raise ValueError(
            f"Package '{parts[0]}' of type '{type_name}' is not installed: "
            "source the install that has it.") from None
    path = Path(share, "msg", parts[2] + suffix)
    if not path.is_file():
        raise ValueError(f"Package '{parts[0]}' has no message '{parts[2]}': {path} is missing.")
    return path
