# SPDX-License-Identifier: BSD-3-Clause
"""Find the objects that other installed packages add to an extensible list of this suite."""

import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any


def registered(group: str, own: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
    """Return the objects that can be chosen by name: the suite's own, then those of other packages.

    Other packages announce theirs by entry points. The last part of their group is the plural of
    what they provide, for example ``piezo_models.effects``. Their code is imported at the look-up,
    so that a broken package affects only those who use it: the look-up raises ValueError if the
    object cannot be imported, or if its attribute ``name`` differs from the name of its entry
    point. ValueError is raised at once if two objects have the same name.
    """
    known: dict[str, Any] = dict(own or {})
    points: dict[str, EntryPoint] = {}
    for point in _announced(group, tuple(sys.path)):
        # A package that is found twice on the path announces the same object twice.
        before = points.setdefault(point.name, point)
        if point.name in known or before.value != point.value:
            raise ValueError(f"two {_plural(group)} are named {point.name}: "
                             "rename one, or uninstall its package")
    return _Registered(group, known, points)


@cache
def _announced(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points found on `path`; cached, as reading them takes up to 20 ms."""
    return tuple(entry_points(group=group))


class _Registered(Mapping[str, Any]):
    """Objects by name; those behind entry points are imported when they are looked up."""

    def __init__(self, group: str, known: dict[str, Any], points: dict[str, EntryPoint]) -> None:
        self._group = group
        self._known, self._points = known, points

    def __getitem__(self, name: str) -> Any:
        if name in self._points:
            return _load(self._group, self._points[name])
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        yield from self._known
        yield from self._points

    def __len__(self) -> int:
        return len(self._known) + len(self._points)

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._points


def _load(group: str, point: EntryPoint) -> Any:
    kind = _plural(group).removesuffix("s")
    try:
        found = point.load()
    except Exception as error:  # any exception of the imported code
        raise ValueError(f"the {kind} {point.name!r} cannot be loaded: {error}; mend or uninstall "
                         "the package that announces it") from error
    name = getattr(found, "name", point.name)
    if name != point.name:
        raise ValueError(f"the {kind} {point.name!r} calls itself {name!r}: "
                         "give its entry point that name")
    return found


def _plural(group: str) -> str:
    return group.rpartition(".")[2]
