# SPDX-License-Identifier: BSD-3-Clause
"""The paths of `scanspec`, a library that is asked for only where one is given."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, CubicSpline

from piezo_common.extras import how_to_install
from piezo_controller.axes.scan_path import ScanPath, check_length
from piezo_controller.references.kind import InvalidReference
from piezo_recorder.sample_block import Mark

GAP = 0.5
"""Time of a gap, as a part of that of the shortest stretch between gaps, or of the time in which
the whole path is crossed at its speed: the quintic over it swings out by less than a quarter."""


def spec_of_file(path: str | Path) -> Any:
    """Read a specification that `scanspec` has serialised to JSON.

    Raises `InvalidReference` if `scanspec` is not installed, or the file is none of its
    specifications.
    """
    try:
        from scanspec.specs import Spec
    except ImportError:
        raise InvalidReference(f"{path} needs the package scanspec, which is not installed: "
                               f"{how_to_install('scanspec', 'scans')}") from None
    try:
        return Spec.deserialize(json.loads(Path(path).read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise InvalidReference(f"{path} is no specification of scanspec: give the JSON of "
                               f"Spec.serialize ({str(error).splitlines()[0]})") from None


def path_of_spec(spec: Any, sample_period_s: float, rate_hz: float | None = None,
                 flyback_s: float | None = None) -> ScanPath:
    """Draw the path of a specification of `scanspec`.

    Its axes have the names of those of the stage, its positions are in um. Its durations count if
    no rate, in frames a second, is given. Frames that touch are crossed at the speed of their
    bounds; over each gap leads a quintic of minimum jerk, in `GAP` of a line's time by default.
    Raises `InvalidReference` if there are neither durations nor a rate.
    """
    from scanspec.core import Path as SpecPath

    stack = spec.calculate()
    axes = tuple(axis for dimension in reversed(stack) for axis in dimension.axes())
    frames = SpecPath(stack).consume()
    lower, middle, upper = (np.column_stack([getattr(frames, name)[axis] for axis in axes])
                            for name in ("lower", "midpoints", "upper"))
    if rate_hz is None and frames.duration is None:
        raise InvalidReference("the specification has no durations: give them, or a rate in frames "
                               "a second")
    lasting = (np.full(len(middle), 1.0 / rate_hz) if rate_hz is not None
               else np.asarray(frames.duration, dtype=float)) / sample_period_s
    first = np.flatnonzero(frames.gap | (np.arange(len(middle)) == 0))
    stretches = np.split(np.arange(len(middle)), first[1:])
    speed = (upper - lower) / lasting[:, None]
    fastest = np.abs(speed).max()
    crossed = np.ptp(middle, axis=0).max() / fastest if fastest else np.inf
    natural = GAP * min(crossed, *(lasting[stretch].sum() for stretch in stretches))
    gap = natural if flyback_s is None else flyback_s / sample_period_s
    times, knots, middles, begins, at = [], [], [], [], 0.0
    for stretch in stretches:
        edges = at + np.r_[0.0, np.cumsum(lasting[stretch])]
        middles.append(0.5 * (edges[:-1] + edges[1:]))
        through = np.r_[edges[0], middles[-1], edges[-1]]
        way = CubicSpline(through, np.concatenate(
            [lower[stretch][:1], middle[stretch], upper[stretch][-1:]]),
            bc_type=((1, speed[stretch[0]]), (1, speed[stretch[-1]])))
        times.append(through)
        knots.append(np.stack([way(through), way(through, 1), way(through, 2)], axis=1))
        begins.append(edges[0])
        at = edges[-1] + gap
    period = round(at)
    check_length(period, sample_period_s)
    every = np.concatenate(knots)
    path = BPoly.from_derivatives(np.r_[np.concatenate(times), period], [*every, every[0]])
    marks = np.zeros(period, dtype=int)
    marks[np.round(np.concatenate(middles)).astype(int)] |= Mark.PIXEL
    marks[np.ceil(begins).astype(int)] |= Mark.LINE
    marks[0] |= Mark.FRAME
    return ScanPath("scanspec", axes, sample_period_s, path(np.arange(period)), marks,
                    1.0 / (lasting.mean() * sample_period_s), np.ptp(middle, axis=0),
                    0.5 * (middle.min(axis=0) + middle.max(axis=0)))
