# SPDX-License-Identifier: BSD-3-Clause
"""A run of the stage along a planned path: what it plays, with the law that it evaluates."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_controller.axes.stored_scan import SAME_PERIOD, StoredScan
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.axes.coupled import CoupledModel
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import FeedbackLaw

REST_S = 0.1
"""Time at the first voltage before a path begins: many decays of the modes."""


@dataclass(frozen=True, eq=False)
class AxesStage:
    """What a run along a path needs to know of a stage of several axes."""

    axes: tuple[str, ...]
    sample_period_s: float
    samples_per_tick: int

    voltage_range_v: FloatArray
    """Lowest and highest voltage of each axis, (n, 2)."""
    rest_voltage_v: FloatArray
    ramp_rate_v_per_s: FloatArray
    """Voltage of each axis at rest, and the rate at which it approaches a path, (n,)."""

    @classmethod
    def of(cls, description: Any) -> "AxesStage":
        """Return the stage that a ``piezo_interfaces/StageDescription`` describes."""
        axes = description.axes
        return cls(
            tuple(axis.name for axis in axes), 1.0 / description.sample_rate_hz,
            description.samples_per_tick,
            np.array([(axis.minimum_voltage_v, axis.maximum_voltage_v) for axis in axes]),
            np.array([axis.rest_voltage_v for axis in axes]),
            np.array([axis.ramp_rate_v_per_s for axis in axes]))


class FollowedScan(NamedTuple):
    """A run of the stage along a path."""

    axes: tuple[str, ...]
    once_voltage_v: FloatArray
    """The way from rest into the path, (B, n)."""
    period_voltage_v: FloatArray
    """One period, which is repeated, (N, n)."""
    period_marks: NDArray[np.uint8]
    """Its marks, (N,); empty if there are none."""
    law: FeedbackLaw | None
    """Acts from the first period on; None without feedback."""
    samples: int
    """Duration until the path has been followed for long enough, in whole ticks."""
    ticks: int


def followed_scan(scan: StoredScan, stage: AxesStage, samples: int, law: AxesLaw | None = None,
                  max_feedback_v: float = math.inf) -> FollowedScan:
    """Return the run that follows a planned path for some samples at least, with an optional law.

    The feedback of each axis has at most `max_feedback_v`, of either sign. Raises ValueError if
    scan or law do not fit the stage, see `check_fit`.
    """
    check_fit("scan", scan, stage)
    if law is not None:
        check_fit("law", law, stage)
    way_v = scan.begin_voltage_v[0] - stage.rest_voltage_v
    ramp_s = float(np.max(np.abs(way_v) / stage.ramp_rate_v_per_s))
    ramp = np.linspace(0.0, 1.0, math.ceil(ramp_s / stage.sample_period_s) + 2)[:, None]
    rest = round(REST_S / stage.sample_period_s)
    once_v = np.concatenate([
        stage.rest_voltage_v + ramp * way_v, np.tile(scan.begin_voltage_v[0], (rest, 1)),
        scan.begin_voltage_v])
    following = None if law is None else _following(law, scan, len(once_v), max_feedback_v)
    ticks = math.ceil((len(once_v) + samples) / stage.samples_per_tick)
    return FollowedScan(scan.axes, once_v, scan.voltage_v, scan.marks, following,
                        ticks * stage.samples_per_tick, ticks)


def check_fit(name: str, made: AxesLaw | CoupledModel | StoredScan, stage: AxesStage) -> None:
    """Raise ValueError if something was made for other axes or another clock than the stage's."""
    if made.axes != stage.axes or abs(
            made.sample_period_s / stage.sample_period_s - 1.0) > SAME_PERIOD:
        raise ValueError(
            f"the {name} has {_axes_text(made)}, the stage {_axes_text(stage)}: take a model that "
            "was identified on this stage at its sample rate")


def _following(law: AxesLaw, scan: StoredScan, start_sample: int,
               max_feedback_v: float) -> FeedbackLaw:
    """Return the law of a run, which expects the way into the path and then the path."""
    begin, start_um = len(scan.begin_voltage_v), law.operating_displacement_um
    before = np.arange(-begin, 0) % len(scan.position_um)
    once_um = np.concatenate([
        np.tile(start_um, (start_sample - begin, 1)),
        start_um + minimum_jerk(begin)[:, None] * (scan.position_um[before] - start_um)])
    return law.following(once_um, scan.position_um, start_sample, max_feedback_v)


def _axes_text(has: AxesStage | AxesLaw | CoupledModel | StoredScan) -> str:
    return (f"the axes {', '.join(has.axes) or '(one without a name)'} at "
            f"{1.0 / has.sample_period_s:.6g} Hz")
