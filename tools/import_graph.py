# SPDX-License-Identifier: BSD-3-Clause
"""Draw which room imports which: docs/pictures/rooms.svg, with the whole list in rooms.txt.

    python tools/import_graph.py [--check]

A room is a folder of a package that holds modules. In the picture a room stands above those that it
imports. Inside a package an arrow goes from room to room, between packages from frame to frame;
what follows from other arrows is not drawn. The list has every import between two rooms.
"""

import argparse
import ast
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "pictures" / "rooms.svg"
LIST = PICTURE.with_suffix(".txt")
NOT_DRAWN = "piezo_interfaces"  # messages, which CMake makes into modules

Edges = dict[tuple[str, str], int]
Way = tuple[tuple[float, float], tuple[float, float]]

# The packages from the bottom of the picture to its top, each row with the middle of each frame in
# inches: chosen so that arrows pass between the frames.
ROWS = (
    {"piezo_common": 9.9},
    {"piezo_models": 4.6, "piezo_ros": 8.4},
    {"piezo_recorder": 4.6, "piezo_stage_driver": 12.0},
    {"piezo_identification": 2.8, "piezo_controller": 7.75, "piezo_bringup": 10.6,
     "piezo_sim": 13.5},
    {"piezo_client": 5.6, "piezo_offline": 7.7},
    {"piezo_studies": 8.2},
)
WIDTH = 15.7
# In inches.
ROOM_WIDTH, ROOM_HEIGHT, GAP, RISE = 1.16, 0.36, 0.16, 0.62
ROW_GAP, MARGIN, TITLE = 0.5, 0.12, 0.26
ARROWS_APART = 0.14
LONGEST_LINE = 14


def main(arguments: list[str] | None = None) -> int:
    """Write picture and list, or with ``--check`` only say whether the list is up to date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if outdated")
    options = parser.parse_args(arguments)
    imports = imports_between_rooms(ROOT / "src")
    text = listed(imports)
    if options.check:
        if LIST.is_file() and LIST.read_text(encoding="utf-8") == text:
            return 0
        print("import_graph: docs/pictures/rooms.txt is outdated: run make tables", file=sys.stderr)
        return 1
    LIST.write_text(text, encoding="utf-8")
    draw(imports, rooms_of(ROOT / "src"))
    return 0


def module_files(source: Path) -> dict[str, Path]:
    """Find the modules of all packages by their dotted names."""
    found = {}
    for path in sorted(source.glob("*/piezo_*/**/*.py")):
        parts = path.relative_to(source).with_suffix("").parts[1:]
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


def room_of(path: Path, source: Path) -> str:
    """Name the room of a module, such as ``piezo_models/effects``."""
    return path.relative_to(source).parent.as_posix().partition("/")[2]


def rooms_of(source: Path) -> list[str]:
    """List the rooms; a package whose modules are all in rooms of their own is none itself."""
    files = module_files(source).values()
    return sorted({room_of(path, source) for path in files
                   if path.name != "__init__.py" or path.read_text().count("\n") > 2})


def imports_between_rooms(source: Path) -> Edges:
    """Count the imports from one room to another, wherever in a module they stand."""
    files = module_files(source)
    counts: Edges = defaultdict(int)
    for path in files.values():
        room = room_of(path, source)
        for name in imported(path):
            while name not in files and "." in name:
                name = name.rpartition(".")[0]
            if name in files and room_of(files[name], source) != room:
                counts[room, room_of(files[name], source)] += 1
    return dict(sorted(counts.items()))


def imported(path: Path) -> Iterable[str]:
    """Yield the dotted names of our own that a module imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name for name in names
                    if name.startswith("piezo_") and not name.startswith(NOT_DRAWN))


def package_of(room: str) -> str:
    """Name the package of a room."""
    return room.partition("/")[0]


def between_packages(imports: Edges) -> Edges:
    """Count the imports from one package to another."""
    counts: Edges = defaultdict(int)
    for (above, below), count in imports.items():
        if package_of(above) != package_of(below):
            counts[package_of(above), package_of(below)] += count
    return dict(counts)


def circles(edges: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Find the groups of nodes each of which reaches all others of its group."""
    reached = reach(edges)
    groups = {frozenset(other for other in reached[node] if node in reached.get(other, ()))
              for node in reached if node in reached[node]}
    return sorted(sorted(group) for group in groups)


def reach(edges: Iterable[tuple[str, str]]) -> dict[str, set[str]]:
    """Find what each node reaches by one edge or more."""
    reached: dict[str, set[str]] = defaultdict(set)
    for above, below in edges:
        reached[above].add(below)
    grown = True
    while grown:
        grown = False
        for node, far in list(reached.items()):
            further = far.union(*(reached[other] for other in list(far) if other in reached))
            grown = grown or further != far
            reached[node] = further
    return dict(reached)


def without_circles(edges: Edges) -> tuple[Edges, Edges]:
    """Part edges into those that go down and the fewest imports that go up again."""
    down, up = dict(edges), {}
    while found := circles(down):
        inside = {edge: count for edge, count in down.items()
                  if any(edge[0] in group and edge[1] in group for group in found)}
        lightest = min(inside, key=lambda edge: (inside[edge], edge))
        up[lightest] = down.pop(lightest)
    return down, up


def reduced(edges: Edges) -> list[tuple[str, str]]:
    """Drop the edges that follow from others; there must be no circle."""
    reached = reach(edges)
    below_of = defaultdict(set)
    for above, below in edges:
        below_of[above].add(below)
    return [(above, below) for above, below in edges
            if not any(below in reached.get(other, ()) for other in below_of[above] - {below})]


def listed(imports: Edges) -> str:
    """Write the list: each room, and the rooms that it imports."""
    lines = ["# Written by `make docs` from the sources; do not edit.",
             "# Each room, and the rooms that its modules import."]
    for above in dict.fromkeys(above for above, _ in imports):
        lines += ["", above, *(f"    -> {below}" for room, below in imports if room == above)]
    return "\n".join(lines) + "\n"


def ranks(rooms: list[str], edges: Edges) -> dict[str, int]:
    """Give each room the length of the longest way down from it; there must be no circle."""
    found = dict.fromkeys(rooms, 0)
    for _ in rooms:
        for above, below in edges:
            found[above] = max(found[above], found[below] + 1)
    return found


class Style(NamedTuple):
    """How an arrow is drawn."""

    color: str
    width: float
    line: str = "-"
    upwards: bool = False


PACKAGE_ARROW = Style("#0072b2", 1.6)
ROOM_ARROW = Style("#444444", 0.8)
ARROW_UP = Style("#d55e00", 0.9, "--", upwards=True)

LEGEND = [
    (ARROW_UP, "dashed: a room imports one above it"),
    (ROOM_ARROW, "thin: a room imports another of its package"),
    (PACKAGE_ARROW, "thick: a package imports another"),
]


class Box(NamedTuple):
    """A rectangle of the picture, in inches."""

    left: float
    bottom: float
    width: float
    height: float

    @property
    def top(self) -> float:
        """Height of the upper edge."""
        return self.bottom + self.height

    @property
    def middle(self) -> float:
        """Place of the middle across the picture."""
        return self.left + self.width / 2

    def steps(self) -> list[float]:
        """List places along an edge at which an arrow may begin or end."""
        count = max(9, round(self.width / 0.12))
        inset = min(0.1, self.width / 10)
        return [self.left + inset + n * (self.width - 2 * inset) / (count - 1)
                for n in range(count)]

    def crossed_by(self, way: Way) -> bool:
        """Tell whether a line that goes down passes the box, or too near."""
        (start, high), (end, low) = way
        if low >= self.top or high <= self.bottom:
            return False
        between = [start + (high - y) / (high - low) * (end - start)
                   for y in (min(high, self.top), max(low, self.bottom))]
        return max(between) > self.left - 0.05 and min(between) < self.left + self.width + 0.05


class Frame:
    """A package's rooms in rows, each row above what it imports.

    Parameters
    ----------
    imports : dict
        All imports between rooms.
    """

    def __init__(self, package: str, rooms: list[str], imports: Edges) -> None:
        self.package = package
        own = {edge: count for edge, count in imports.items()
               if edge[0] in rooms and edge[1] in rooms}
        down, self.up = without_circles(own)
        self.down = reduced(down)
        rank = ranks(rooms, down)
        self._rows = [[room for room in rooms if rank[room] == level]
                      for level in range(max(rank.values(), default=0) + 1)]
        if not self.down:  # no room stands above another: one row may be too long
            self._rows = [rooms[first:first + 5] for first in range(0, len(rooms), 5)]
        self._sort()
        self._widest = max(map(len, self._rows), default=1)
        self.width = 2 * MARGIN + self._widest * (ROOM_WIDTH + GAP) - GAP
        self.height = 2 * MARGIN + TITLE + (len(self._rows) - 1) * RISE + ROOM_HEIGHT

    def _sort(self) -> None:
        """Put each room near the mean of what it imports, so that few arrows cross."""
        for level in range(1, len(self._rows)):
            place = {room: index - len(row) / 2 for row in self._rows[:level]
                     for index, room in enumerate(row)}

            def middle(room: str, place: dict[str, float] = place) -> float:
                found = [place[below] for above, below in self.down
                         if above == room and below in place]
                return sum(found) / len(found) if found else 0.0

            self._rows[level].sort(key=middle)

    def places(self, left: float, bottom: float) -> dict[str, Box]:
        """Find the box of each room, for a frame that stands here."""
        found = {}
        for level, row in enumerate(self._rows):
            used = len(row) * (ROOM_WIDTH + GAP) - GAP
            first = left + (self.width - used) / 2
            for index, room in enumerate(row):
                found[room] = Box(first + index * (ROOM_WIDTH + GAP),
                                  bottom + MARGIN + level * RISE, ROOM_WIDTH, ROOM_HEIGHT)
        return found


def draw(imports: Edges, rooms: list[str]) -> None:
    """Draw the picture."""
    import matplotlib
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "rooms"  # the same picture from the same sources
    frames = {package: Frame(package, [room for room in rooms if package_of(room) == package],
                             imports) for row in ROWS for package in row}
    corners, bottom = {}, 0.0
    for row in ROWS:
        corners |= {package: (middle - frames[package].width / 2, bottom)
                    for package, middle in row.items()}
        bottom += max(frames[package].height for package in row) + ROW_GAP
    height = bottom - ROW_GAP
    figure = Figure(figsize=(WIDTH, height + 0.1))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(-0.05, height + 0.05), aspect="equal")
    axes.axis("off")
    boxes = {package: Box(left, bottom, frames[package].width, frames[package].height)
             for package, (left, bottom) in corners.items()}
    draw_arrows(axes, reduced(between_packages(imports)), boxes, PACKAGE_ARROW, [])
    for package, box in boxes.items():
        draw_frame(axes, frames[package], box)
    for line, (style, text) in enumerate(LEGEND):
        axes.text(0.1, 0.1 + 0.22 * line, text, color=style.color, fontsize=10)
    figure.savefig(PICTURE, metadata={"Date": None})


def draw_frame(axes, frame: Frame, box: Box) -> None:
    """Draw the frame of a package, its rooms and the arrows between them."""
    draw_box(axes, box, "#f3f6fa", "#6b7c93", 0)
    axes.text(box.left + MARGIN, box.top - 0.09, frame.package, fontsize=10, fontweight="bold",
              va="top", zorder=5)
    rooms = frame.places(box.left, box.bottom)
    taken: list[Way] = []
    draw_arrows(axes, frame.down, rooms, ROOM_ARROW, taken)
    draw_arrows(axes, [(below, above) for above, below in frame.up], rooms, ARROW_UP, taken)
    for room, place in rooms.items():
        draw_box(axes, place, "white", "#444444", 4)
        name = room.partition("/")[2].rpartition("/")[2].replace("_", " ") or "(top)"
        name = name.replace(" ", "\n") if len(name) > LONGEST_LINE else name
        axes.text(place.left + place.width / 2, place.bottom + place.height / 2, name,
                  fontsize=9, linespacing=0.9, ha="center", va="center", zorder=5)


def draw_box(axes, box: Box, face: str, edge: str, order: int) -> None:
    """Draw a box with round corners."""
    from matplotlib.patches import FancyBboxPatch

    axes.add_patch(FancyBboxPatch(
        (box.left, box.bottom), box.width, box.height, boxstyle="round,pad=0,rounding_size=0.06",
        facecolor=face, edgecolor=edge, linewidth=0.9, zorder=order))


def draw_arrows(axes, edges: list[tuple[str, str]], boxes: dict[str, Box], style: Style,
                taken: list[Way]) -> None:
    """Draw arrows from box to box, the short ones first, past the boxes between them."""
    from matplotlib.patches import FancyArrowPatch

    for above, below in sorted(edges, key=lambda edge: (
            boxes[edge[0]].bottom - boxes[edge[1]].top, edge)):
        others = [box for name, box in boxes.items() if name not in (above, below)]
        way = clearest_way(boxes[above], boxes[below], others, taken)
        taken.append(way)
        ends = [way[1], way[0]] if style.upwards else way
        axes.add_patch(FancyArrowPatch(
            *ends, arrowstyle="-|>", mutation_scale=5 + 3 * style.width, color=style.color,
            linewidth=style.width, linestyle=style.line, shrinkA=0, shrinkB=0, zorder=3))


def clearest_way(above: Box, below: Box, others: list[Box], taken: list[Way]) -> Way:
    """Find a straight way from a box to one below it that passes few others, and is steep."""
    def cost(way: Way) -> tuple[int, float]:
        (start, _), (end, _) = way
        passed = sum(box.crossed_by(way) for box in others)
        crowded = sum(abs(start - other[0][0]) < ARROWS_APART and other[0][1] == way[0][1]
                      or abs(end - other[1][0]) < ARROWS_APART and other[1][1] == way[1][1]
                      for other in taken)
        off = abs(start - above.middle) + abs(end - below.middle)
        return passed, crowded + abs(start - end) + 0.3 * off

    return min((((start, above.bottom), (end, below.top))
                for start in above.steps() for end in below.steps()), key=cost)


if __name__ == "__main__":
    sys.exit(main())
