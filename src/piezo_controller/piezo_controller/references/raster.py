# SPDX-License-Identifier: BSD-3-Clause
"""Raster scan of a microscope: the fast axis draws lines, the slow axis steps from one to the next.

Both axes share one clock. A line goes forward, while the picture is taken, and back. The fast
axis turns at the beginning and in the middle of the line's period. The slow axis steps while the
fast one goes back, and flies back to the first line after the last.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import (
    LONGEST_PERIOD_S,
    InvalidReference,
    Reference,
    Watch,
    one_component,
)
from piezo_controller.references.smooth_rise import smooth_rise
from piezo_controller.references.trajectory import FormulaTrajectory, Trajectory

AXES = ("fast", "slow")

TURN = 0.1
"""Part of a line's period that each turn of the fast axis takes."""

STEP_BEGINS, STEP_ENDS = 0.55, 0.95
"""Part of a line's period in which the slow axis steps."""

FLYBACK = 0.05
"""Duration of the slow axis' flyback, as a part of the frame's number of lines."""


def fast_axis(lines: ArrayLike) -> FloatArray:
    """Return the fast axis' displacement at times in lines, from the middle of the way forward.

    The speed is constant between the turns, where the displacement goes from -0.5 to 0.5; in the
    turns it overshoots.
    """
    # Integrals of a speed of +1 forward and -1 back that changes its sign smoothly in the turns.
    since_begin = (np.asarray(lines) + 0.75) % 1.0 - 0.5
    since_middle = (np.asarray(lines) + 0.25) % 1.0 - 0.5
    position = np.where(
        np.abs(since_begin) < 0.25,
        2 * TURN * _risen(since_begin / TURN + 0.5) - since_begin - 0.25,
        since_middle - 2 * TURN * _risen(since_middle / TURN + 0.5) + 0.25)
    return position / (0.5 - TURN)


def _risen(share: FloatArray) -> FloatArray:
    """Integrate `smooth_rise` from 0 to its argument."""
    within = np.clip(share, 0.0, 1.0)
    return within**4 * (2.5 - 3 * within + within**2) + np.maximum(share - 1.0, 0.0)


def flyback_lines(lines: int) -> int:
    """Return the number of lines that the flyback of a frame takes."""
    return max(1, round(FLYBACK * lines))


def slow_axis(at_line: FloatArray, lines: int) -> FloatArray:
    """Return the slow axis' staircase from -0.5 to 0.5, followed by the flyback.

    Times are counted in lines since the frame's beginning, within the frame and its flyback.
    """
    back = flyback_lines(lines)
    clock = at_line + 0.25
    line = np.floor(clock)
    step = smooth_rise((clock - line - STEP_BEGINS) / (STEP_ENDS - STEP_BEGINS))
    staircase = np.minimum(line + step, lines - 1) / (lines - 1)
    # The flyback begins when the last line has been drawn and ends before the frame does.
    way = smooth_rise((clock - (lines - 1 + STEP_BEGINS)) / (back + STEP_ENDS - STEP_BEGINS))
    # Beyond the frame's end on the common clock lies the first line of the next frame.
    return np.where(clock < lines + back, staircase * (1.0 - way), 0.0) - 0.5


class Raster:
    """One axis of a raster; the period is a line of the fast axis, or a frame of the slow one."""

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return whether the period is short enough to be uploaded."""
        return _period_samples(reference, sample_rate_hz) <= LONGEST_PERIOD_S * sample_rate_hz

    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Sample a line of the fast axis, or a frame of the slow one."""
        return _displacement_um(reference, sample_rate_hz,
                                np.arange(_period_samples(reference, sample_rate_hz)))

    def trajectory(self, reference: Reference, sample_rate_hz: float, watch: Watch) -> Trajectory:
        """Return the repeated period, which is computed piece by piece and may be long."""
        samples = _period_samples(reference, sample_rate_hz)
        return FormulaTrajectory(
            lambda at: _displacement_um(reference, sample_rate_hz, at % samples))


def _line_samples(reference: Reference, sample_rate_hz: float) -> int:
    line_rate_hz, _, _ = one_component(reference, sample_rate_hz)
    samples = round(sample_rate_hz / line_rate_hz)
    if abs(samples * line_rate_hz / sample_rate_hz - 1) > 1e-9:
        raise InvalidReference(
            f"a line at {line_rate_hz:.12g} Hz has no whole number of samples: the nearest that "
            f"has is {sample_rate_hz / samples:.12g} Hz")
    if reference.axis not in AXES:
        raise InvalidReference(f"unknown axis {reference.axis!r} of the raster: "
                               f'use one of {", ".join(AXES)}')
    if reference.axis == "slow" and reference.lines < 2:
        raise InvalidReference(f"the raster has {reference.lines} lines: give at least 2")
    return samples


def _period_samples(reference: Reference, sample_rate_hz: float) -> int:
    samples = _line_samples(reference, sample_rate_hz)
    lines = 1 if reference.axis == "fast" else reference.lines + flyback_lines(reference.lines)
    return samples * lines


def _displacement_um(reference: Reference, sample_rate_hz: float,
                     at: NDArray[np.int64]) -> FloatArray:
    lines = at / _line_samples(reference, sample_rate_hz)
    shape = fast_axis(lines) if reference.axis == "fast" else slow_axis(lines, reference.lines)
    return reference.centre_um + reference.amplitude_um[0] * shape
