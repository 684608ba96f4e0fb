# SPDX-License-Identifier: BSD-3-Clause
"""Patterns of scanning microscopes, drawn over one period at any sample rate.

Straight parts and rests are joined by quintics of minimum jerk: position, speed and acceleration go
on without a jump, so that the spectrum falls by the fourth power of the frequency.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BPoly, CubicSpline

from piezo_common.arrays import FloatArray
from piezo_controller.axes.path_files import points_of_file, positions_of_file
from piezo_controller.axes.scan_path import ScanPath, check_length
from piezo_controller.references.kind import InvalidReference
from piezo_recorder.sample_block import Mark

BOTH_TURN, FLYBACK = 0.2, 0.4
"""Parts of a line's time between the end of a line and the beginning of the next, where lines go
both ways and where they go one way."""

FRAME_FLYBACK = 0.05
"""Part of a frame's time for the way from its last line to the first."""

PARKED = 3.0
"""Times between lines from which on the way back of a frame has a rest in it: a single quintic that
has to end at a line's speed would swing out the farther the longer it takes."""

MOVE = 0.5
"""Part of the time of a point for the way to it."""

CORE = 0.2
"""Part of a spiral's radius within which its turns, not its speed, are constant: there a constant
speed would take turns at any rate."""

STEPS_A_TURN = 64
"""At which the time of a spiral is integrated: its error is below 1e-6 of a turn."""


@dataclass(frozen=True)
class ScanPattern:
    """A pattern, field by field."""

    kind: str = "raster"
    """One of `PATTERNS`."""
    size_um: tuple[float, float] = (10.0, 10.0)
    """Size of the image along the fast and the slow axis, or the two diameters."""
    centre_um: tuple[float, ...] = (0.0, 0.0)

    rate_hz: float = 10.0
    """Lines a second of a raster; turns of a spiral (at its fastest), of a rosette through its
    centre and of a cycloid; of the first axis of a Lissajous figure; points or frames."""
    lines: int = 64
    """Number of lines of a raster, of turns of a spiral from centre to rim and of a cycloid, of
    periods of the first axis of a Lissajous figure (the other has one less), or of lobes of a
    rosette."""
    pixels: int | None = None
    """Pixels of a line or of a turn; by default as many as lines if there are enough samples."""
    both_directions: bool = False
    """Lines of a raster go forward and backward."""
    flyback_s: float | None = None
    """Time in s from the end of a line to the beginning of the next."""
    frame_flyback_s: float | None = None
    """Time in s from the last line to the first."""
    linear_velocity: bool = False
    """True for a spiral at constant speed instead of constant angular velocity."""
    points_um: ArrayLike | None = None
    """Positions of the kind ``points``, (K, m)."""
    file: str | Path | None = None
    """CSV with the columns ``x_displacement_um,y_displacement_um``: points, or with ``time_s`` one
    period."""


class Drawn(NamedTuple):
    """A pattern about its centre; times are counted in samples."""

    position_um: FloatArray
    """Shape (N, 2)."""
    frames: FloatArray
    """When frames begin."""
    rows: FloatArray
    """Begin and end of each line, and 1 or -1 for its direction, (K, 3)."""


def scan_path(pattern: ScanPattern, sample_period_s: float,
              axes: tuple[str, ...] = ("x", "y")) -> ScanPath:
    """Draw a pattern; its rate becomes one of whole samples.

    The axes are those that move: of a pattern two, the fast one first. Raises `InvalidReference` if
    the fields make no sense for the kind.
    """
    if pattern.kind == "file":
        return _of_file(pattern, sample_period_s)
    if pattern.kind not in KINDS:
        raise InvalidReference(f"unknown pattern {pattern.kind!r}: use one of {', '.join(KINDS)}")
    _check(pattern, sample_period_s)
    if pattern.kind == "points":
        return _points(pattern, sample_period_s, axes)
    if len(axes) != 2:
        raise InvalidReference(f"a {pattern.kind} moves two axes, not {', '.join(axes)}: name two")
    per_cycle = max(round(1.0 / (pattern.rate_hz * sample_period_s)), 1)
    drawn = PATTERNS[pattern.kind](pattern, per_cycle, sample_period_s)
    centre_um = np.asarray(pattern.centre_um, dtype=float)
    return ScanPath(pattern.kind, axes, sample_period_s, centre_um + drawn.position_um,
                    _marks(pattern, drawn), 1.0 / (per_cycle * sample_period_s),
                    np.array(pattern.size_um, dtype=float), centre_um)


def _check(pattern: ScanPattern, sample_period_s: float) -> None:
    if not 0.0 < pattern.rate_hz <= 0.25 / sample_period_s:
        raise InvalidReference(f"the rate is {pattern.rate_hz:g} Hz: give one above 0 and up to a "
                               f"quarter of the sample rate of {1.0 / sample_period_s:.6g} Hz")
    if not all(0.0 <= size_um < np.inf for size_um in pattern.size_um) or not any(pattern.size_um):
        raise InvalidReference(f"the size is {pattern.size_um} um: give positive numbers")
    if pattern.lines < 2:
        raise InvalidReference(f"the path has {pattern.lines} lines: give at least 2")


def _marks(pattern: ScanPattern, drawn: Drawn) -> NDArray[np.int64]:
    marks = np.zeros(len(drawn.position_um), dtype=int)
    begin, end, way = drawn.rows.T
    room = int((end - begin).min())
    pixels = min(pattern.lines, room) if pattern.pixels is None else pattern.pixels
    if not 0 <= pixels <= room:
        raise InvalidReference(f"a line has {room} samples and {pixels} pixels: give no more "
                               "pixels than samples, or a lower rate")
    share = (np.arange(pixels) + 0.5) / max(pixels, 1)
    at_pixels = np.round(begin[:, None] + (end - begin)[:, None] * share).astype(int) % marks.size
    at_lines, at_frames = (
        np.ceil(times).astype(int) % marks.size for times in (begin, drawn.frames))
    marks[at_pixels] |= Mark.PIXEL
    marks[at_lines] |= Mark.LINE
    marks[at_frames] |= Mark.FRAME
    marks[at_lines[way < 0.0]] |= Mark.BACKWARD
    marks[at_pixels[way < 0.0]] |= Mark.BACKWARD
    return marks


def joined(begins: FloatArray, ends: FloatArray, begin_at: FloatArray, end_at: FloatArray,
           period: float, stop: float = 0.0) -> BPoly:
    """Join straight runs at constant speed by quintics of minimum jerk, periodically.

    The runs have positions, (K, m), and times, (K,), which rise from 0 to the period, after which
    the first run begins again. If `stop` is positive, it is the time in which the last run comes to
    rest before the way back, and the first one sets out after it.
    """
    speed = (ends - begins) / (end_at - begin_at)[:, None]
    rest = np.zeros_like(begins)
    times = np.column_stack([begin_at, end_at]).ravel()
    knots = np.stack([np.stack([begins, speed, rest], 1), np.stack([ends, speed, rest], 1)], 1)
    knots = knots.reshape(-1, 3, begins.shape[1])
    if stop:
        still = np.zeros((2, *begins.shape[1:]))
        stopped = np.stack([ends[-1] + speed[-1] * stop / 2.0, *still])
        ready = np.stack([begins[0] - speed[0] * stop / 2.0, *still])
        times = np.r_[times, end_at[-1] + stop, period - stop]
        knots = np.concatenate([knots, [stopped, ready]])
    return BPoly.from_derivatives(np.r_[times, period], [*knots, knots[0]])


def _raster(pattern: ScanPattern, per_line: int, sample_period_s: float) -> Drawn:
    lines, both = pattern.lines, pattern.both_directions
    flyback = ((BOTH_TURN if both else FLYBACK) * per_line if pattern.flyback_s is None
               else pattern.flyback_s / sample_period_s)
    if not 0.0 < flyback < per_line:
        raise InvalidReference(f"the fly-back takes {flyback * sample_period_s:g} s of a line's "
                               f"{per_line * sample_period_s:g} s: give more than 0 and less")
    frame_flyback = (max(FRAME_FLYBACK * lines * per_line, PARKED * flyback)
                     if pattern.frame_flyback_s is None
                     else pattern.frame_flyback_s / sample_period_s)
    if frame_flyback < flyback:
        raise InvalidReference(
            f"the fly-back of the frame takes {frame_flyback * sample_period_s:g} s, less than "
            f"that of a line, {flyback * sample_period_s:g} s: give at least as much")
    period = round(lines * per_line - flyback + frame_flyback)
    check_length(period, sample_period_s)
    way = np.where(both & (np.arange(lines) % 2 == 1), -1.0, 1.0)
    begin_at = per_line * np.arange(lines, dtype=float)
    end_at = begin_at + per_line - flyback
    fast_um, slow_um = 0.5 * np.array(pattern.size_um)
    across_um = slow_um * np.linspace(-1.0, 1.0, lines)
    path = joined(np.column_stack([-fast_um * way, across_um]),
                  np.column_stack([fast_um * way, across_um]), begin_at, end_at, float(period),
                  0.5 * flyback if frame_flyback >= PARKED * flyback else 0.0)
    return Drawn(path(np.arange(period)), np.zeros(1), np.column_stack([begin_at, end_at, way]))


def _there_and_back(straight: int, turn: int) -> BPoly:
    """Return the way from -1 to 1 and back over ``2 (straight + turn)``, straight between turns."""
    one = np.array([[1.0]])
    return joined(np.concatenate([-one, one]), np.concatenate([one, -one]),
                  np.array([0.0, straight + turn]), np.array([straight, 2.0 * straight + turn]),
                  2.0 * (straight + turn))


def _spiral(pattern: ScanPattern, per_turn: int, sample_period_s: float) -> Drawn:
    straight = 2 * pattern.lines  # through the centre to the other side
    turning = max(1, round(BOTH_TURN * pattern.lines))
    turns = 2 * (straight + turning)
    check_length(turns * per_turn, sample_period_s)
    radius = _there_and_back(straight, turning)
    angle = np.linspace(0.0, turns, turns * STEPS_A_TURN + 1)
    slower = np.ones_like(angle)
    if pattern.linear_velocity:
        slower = (1.0 + (radius(angle)[:, 0] / CORE) ** 4) ** 0.25
    taken = cumulative_simpson(slower, x=angle, initial=0.0)
    samples = round(taken[-1] * per_turn)
    check_length(samples, sample_period_s)
    taken *= samples / taken[-1]
    at = CubicSpline(taken, angle)(np.arange(samples))
    centres = np.interp([0.5 * straight, 1.5 * straight + turning], angle, taken)
    return Drawn(_round(radius(at)[:, 0], at, pattern.size_um), centres,
                 _rows(np.interp(np.arange(turns + 1), angle, taken)))


def _round(radius: FloatArray, turns: FloatArray, size_um: tuple[float, float]) -> FloatArray:
    angle_rad = 2.0 * np.pi * turns
    return 0.5 * np.array(size_um) * radius[:, None] * np.column_stack(
        [np.cos(angle_rad), np.sin(angle_rad)])


def _rows(edges: FloatArray) -> FloatArray:
    return np.column_stack([edges[:-1], edges[1:], np.ones(edges.size - 1)])


def _even(cycles: int, per_cycle: int, sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the share of the period of each sample, and the edges of the cycles."""
    check_length(cycles * per_cycle, sample_period_s)
    return (np.arange(cycles * per_cycle) / (cycles * per_cycle),
            per_cycle * np.arange(cycles + 1, dtype=float))


def _lissajous(pattern: ScanPattern, per_cycle: int, sample_period_s: float) -> Drawn:
    share, edges = _even(pattern.lines, per_cycle, sample_period_s)
    angles_rad = 2.0 * np.pi * share[:, None] * [pattern.lines, pattern.lines - 1]
    return Drawn(0.5 * np.array(pattern.size_um) * np.sin(angles_rad), np.zeros(1), _rows(edges))


def _rosette(pattern: ScanPattern, per_cycle: int, sample_period_s: float) -> Drawn:
    share, edges = _even(pattern.lines, per_cycle, sample_period_s)
    radius = np.sin(2.0 * np.pi * pattern.lines * share)
    return Drawn(_round(radius, share, pattern.size_um), np.zeros(1), _rows(edges))


def _cycloid(pattern: ScanPattern, per_turn: int, sample_period_s: float) -> Drawn:
    turning = max(1, round(BOTH_TURN * pattern.lines))
    turns = 2 * (pattern.lines + turning)
    share, edges = _even(turns, per_turn, sample_period_s)
    along = _there_and_back(pattern.lines, turning)(turns * share)
    width_um, height_um = pattern.size_um
    position_um = _round(np.ones_like(share), turns * share, (height_um, height_um))
    position_um[:, 0] += 0.5 * width_um * along[:, 0]
    frames = np.array([0.0, (pattern.lines + turning) * per_turn])
    return Drawn(position_um, frames, _rows(edges))


def _points(pattern: ScanPattern, sample_period_s: float, axes: tuple[str, ...]) -> ScanPath:
    if pattern.file is not None:
        axes, points_um = points_of_file(pattern.file)
    else:
        points_um = np.atleast_2d(np.asarray(pattern.points_um, dtype=float))
    if points_um.ndim != 2 or len(points_um) < 2 or points_um.shape[1] != len(axes):
        raise InvalidReference(f"the points have the shape {points_um.shape}: give two or more, "
                               f"each with a number for each of {', '.join(axes)}")
    per_point = round(1.0 / (pattern.rate_hz * sample_period_s))
    begin_at = per_point * np.arange(len(points_um), dtype=float)
    period = per_point * len(points_um)
    check_length(period, sample_period_s)
    end_at = begin_at + (1.0 - MOVE) * per_point
    position_um = joined(points_um, points_um, begin_at, end_at, float(period))(np.arange(period))
    marks = np.zeros(period, dtype=int)
    marks[begin_at.astype(int)] = Mark.PIXEL
    marks[0] |= Mark.FRAME
    return ScanPath("points", axes, sample_period_s, position_um, marks,
                    1.0 / (per_point * sample_period_s), np.ptp(points_um, axis=0),
                    points_um.mean(axis=0))


def _of_file(pattern: ScanPattern, sample_period_s: float) -> ScanPath:
    if pattern.file is None:
        raise InvalidReference("a path of the kind file has no file: name a CSV")
    axes, position_um, marks = positions_of_file(pattern.file, sample_period_s)
    return ScanPath("file", axes, sample_period_s, position_um, marks,
                    1.0 / (len(position_um) * sample_period_s), np.ptp(position_um, axis=0),
                    position_um.mean(axis=0))


PATTERNS: dict[str, Callable[[ScanPattern, int, float], Drawn]] = {
    "raster": _raster, "spiral": _spiral, "lissajous": _lissajous, "rosette": _rosette,
    "cycloid": _cycloid}
"""By the pattern, the samples of a line or turn, and the sample period."""

KINDS = (*PATTERNS, "points", "file")
