# SPDX-License-Identifier: BSD-3-Clause
"""Raster scan of a microscope: the fast axis draws lines, the slow axis steps from one to the next.

Both axes share one clock: a line goes forward, on which the picture is taken, and back. The fast
axis turns at the beginning and in the middle of the line's period; the slow axis steps while the
fast one goes back, and after the last line it flies back to the first.
"""

import numpy as np

from piezo_controller.smooth_rise import smooth_rise

TURN = 0.1
"""Part of a line's period that each turn of the fast axis takes."""

STEP_BEGINS, STEP_ENDS = 0.55, 0.95
"""Part of a line's period in which the slow axis steps."""

FLYBACK = 0.05
"""Lines that the slow axis' way back takes, as a part of those of the frame."""


def fast_axis(samples_per_line):
    """One line, forward and back, beginning in the middle of the way forward.

    Its speed is constant between the turns, where the displacement goes from -0.5 to 0.5; in the
    turns it overshoots.

    Returns
    -------
    (samples_per_line,) array
    """
    phase = (np.arange(samples_per_line) / samples_per_line + 0.25) % 1.0
    since_begin = (phase + 0.5) % 1.0 - 0.5
    speed = np.where(np.abs(since_begin) < 0.25,
                     2.0 * smooth_rise(since_begin / TURN + 0.5) - 1.0,
                     1.0 - 2.0 * smooth_rise((phase - 0.5) / TURN + 0.5))
    position = np.cumsum((speed + np.roll(speed, 1)) / 2) / samples_per_line
    position -= (position.max() + position.min()) / 2
    return position / (0.5 - TURN)


def flyback_lines(lines):
    """Lines that the way back of a frame takes."""
    return max(1, round(FLYBACK * lines))


def slow_axis(samples_per_line, lines):
    """One frame: a staircase from -0.5 to 0.5 in step with `fast_axis`, and the way back.

    Returns
    -------
    (samples_per_line * (lines + flyback_lines(lines)),) array
    """
    back = flyback_lines(lines)
    clock = np.arange(samples_per_line * (lines + back)) / samples_per_line + 0.25
    line = np.floor(clock)
    step = smooth_rise((clock - line - STEP_BEGINS) / (STEP_ENDS - STEP_BEGINS))
    staircase = np.minimum(line + step, lines - 1) / (lines - 1)
    # The way back begins when the last line has been drawn and ends before the frame does.
    way = smooth_rise((clock - (lines - 1 + STEP_BEGINS)) / (back + STEP_ENDS - STEP_BEGINS))
    # What lies behind the frame's end on the common clock belongs to the next first line.
    return np.where(clock < lines + back, staircase * (1.0 - way), 0.0) - 0.5
