# SPDX-License-Identifier: BSD-3-Clause
"""Several axes track a path: planned as by `scan`, and measured axis by axis."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.axes.followed_scan import AxesStage, check_fit, followed_scan
from piezo_controller.axes.path_plan import PathPlan
from piezo_controller.axes.patterns import KINDS, PATTERNS
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import stored_scan
from piezo_controller.feedforward.periodic import SETTLE_S, FeedforwardPlan
from piezo_controller.references.kind import InvalidReference, Reference
from piezo_controller.tracking.feedbacks import Feedbacks
from piezo_controller.tracking.track import (
    PreparedRun,
    Steps,
    TrackRequest,
    check_times,
    whole_ticks,
)
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import load_axes_model

MODES_OF_AXES = ("open_loop", "feedforward", "composite")


class AxesTrackingRun:
    """A run of several axes, by their names in the order of the stage, each measured by itself.

    What is one number for all axes is that of the worst one.
    """

    expected_um: FloatArray = np.empty(0)
    """Empty, as what is published of a reference holds one axis."""

    def __init__(self, runs: Mapping[str, TrackingRun]) -> None:
        self._runs = runs
        self._any = next(iter(runs.values()))

    @property
    def total_samples(self) -> int:
        """Return the samples of the approach and of the part that counts."""
        return self._any.total_samples

    @property
    def complete(self) -> bool:
        """Return whether all samples that count have been taken."""
        return self._any.complete

    @property
    def begun(self) -> bool:
        """Return whether a sample that counts has been taken."""
        return self._any.begun

    @property
    def fraction(self) -> float:
        """Return the fraction of the run that is done (0 to 1)."""
        return self._any.fraction

    @property
    def on_target(self) -> bool:
        """Return whether the errors of all axes are within their tolerances now."""
        return all(run.on_target for run in self._runs.values())

    @property
    def tolerance_um(self) -> float:
        """Return the smallest tolerance of an axis (um)."""
        return min(run.tolerance_um for run in self._runs.values())

    @property
    def settled_after_sample(self) -> float:
        """Return the sample from which on all were within their tolerances; NaN if one is not."""
        return float(np.max([run.settled_after_sample for run in self._runs.values()]))

    @property
    def largest_error_um(self) -> float:
        """Return the largest error of an axis (um)."""
        return float(np.max([run.largest_error_um for run in self._runs.values()]))

    @property
    def note(self) -> str:
        """Return the errors of each axis, and which did not follow; empty before any counts."""
        if not self.begun:
            return ""
        return "; ".join(
            f"{axis}: e_rms {run.e_rms_percent():.4g} %, largest error {run.largest_error_um:.4g} "
            f"um{', ' * bool(run.note)}{run.note}" for axis, run in self._runs.items())

    def take(self, displacement_um: FloatArray) -> float:
        """Take the next block of samples, a value of each axis sample by sample; return 0 V."""
        for run, own_um in zip(self._runs.values(),
                               displacement_um.reshape(-1, len(self._runs)).T, strict=True):
            run.take(own_um)
        return 0.0

    def e_rms_percent(self, running: bool = False) -> float:
        """Return the largest error (2.32) of an axis; see `TrackingRun.e_rms_percent`."""
        return float(np.max([run.e_rms_percent(running) for run in self._runs.values()]))


@dataclass(frozen=True, eq=False)
class _AlongAxis(FeedforwardPlan):
    """The part of one axis in a path."""

    whole_travel_um: float = field(kw_only=True)
    """That of the whole path, see `StoredScan.travel_um`."""

    def travel_um(self, samples: int) -> float:
        """Return the travel of the whole path, also for a run that ends within its first line."""
        return self.whole_travel_um


def prepare_path(request: TrackRequest, clock: StageClock, stage: AxesStage, feedbacks: Feedbacks,
                 steps: Steps, window_s: float = 0.1) -> PreparedRun:
    """Prepare the run of a request to a stage of several axes.

    The request has one reference, whose frequency is the rate of the path, and whose amplitudes are
    its sizes along the fast and the slow axis, or one for both. The path is one of
    `piezo_controller.axes.scan`, about the operating point of the model. The error counts once the
    path has been followed for a tenth of a second. Raises ValueError, which says what cannot be
    done, and what to change.
    """
    check_times(request)
    if request.mode not in MODES_OF_AXES:
        raise ValueError(f"several axes do not track in the mode {request.mode!r}: use one of "
                         f"{', '.join(MODES_OF_AXES)}, or learn the voltages with `stage scan`")
    if len(request.references) > 1 or request.inversion:
        raise ValueError("several axes repeat one path by its exact inverse: leave then and "
                         "inversion empty")
    steps.begin("plan")
    model = load_axes_model(request.model)
    check_fit("model", model.model, stage)
    plan = _planned(request.references[0], model, clock, stage)
    law = None
    if request.mode == "open_loop":
        plan = plan.without_inverse()
    elif request.mode == "composite":
        steps.begin("design the feedback")
        law = feedbacks.law_of_axes(model.model, request.model_sha256)
    settle = round(SETTLE_S / clock.sample_period_s)
    run_samples = whole_ticks(request.durations_s[0], clock)
    stored = stored_scan(plan)
    followed = followed_scan(stored, stage, settle + run_samples, law, feedbacks.max_feedback_v)
    voltage_v, position_um = (np.roll(each, -settle, axis=0)
                              for each in (stored.voltage_v, stored.position_um))
    marks = np.roll(stored.marks, -settle)
    start = len(followed.once_voltage_v)
    settling = np.arange(-settle, 0) % len(voltage_v)
    once_v = np.concatenate([followed.once_voltage_v, voltage_v[settling]])
    once_um = position_um[np.arange(-len(once_v), 0) % len(position_um)]
    once_marks = np.concatenate([np.zeros(start, np.uint8), marks[settling]])
    runs = {axis: TrackingRun(
        _AlongAxis(once_v[:, at], voltage_v[:, at], once_um[:, at], position_um[:, at], start,
                   whole_travel_um=float(stored.travel_um[at])),
        run_samples, tick_s=clock.tick_s, tolerance_um=request.tolerance_um,
        window_samples=round(window_s * clock.sample_rate_hz))
        for at, axis in enumerate(stage.axes)}
    return PreparedRun(FeedforwardPlan(once_v, voltage_v, once_um, position_um, start), None,
                       AxesTrackingRun(runs), law=followed.law, axes=stage.axes,
                       marks=(once_marks.tobytes(), marks.tobytes()),
                       attachments=stored.attachments)


def _planned(reference: Reference, model: IdentifiedAxes, clock: StageClock,
             stage: AxesStage) -> PathPlan:
    """Plan the path of a reference within the voltages of both the model and the stage."""
    kind, sizes_um = reference.kind, tuple(reference.amplitude_um)
    if kind not in (*KINDS, "scanspec"):
        raise InvalidReference(f"several axes follow no {kind!r}: use one of "
                               f"{', '.join(KINDS)}, scanspec")
    if (kind in PATTERNS) == bool(reference.file):
        raise InvalidReference(f"a path of the kind {kind} " + (
            "takes no file: leave it out" if kind in PATTERNS else "needs a file: name it"))
    if reference.centre_um or len(reference.phase_rad) or reference.once:
        raise InvalidReference("a path of several axes is repeated about the operating point of "
                               "the model: leave centre_um, phase_rad and once out")
    if len(reference.frequency_hz) > 1 or len(sizes_um) > 2:
        raise InvalidReference(f"the path has {len(reference.frequency_hz)} rates and "
                               f"{len(sizes_um)} sizes: give one frequency_hz, and one or two "
                               "amplitude_um")
    fields: dict[str, Any] = {"file": reference.file} if reference.file else {
        "lines": reference.lines}
    if len(reference.frequency_hz):
        fields["rate_hz"] = reference.frequency_hz[0]
    if sizes_um:
        fields["size_um"] = sizes_um * (2 // len(sizes_um))
    lowest_v, highest_v = np.stack([model.voltage_range_v, stage.voltage_range_v]).T
    return scan(model, kind, slew_limit_v_per_s=clock.slew_limit_v_per_s,
                voltage_range_v=np.column_stack([lowest_v.max(axis=1), highest_v.min(axis=1)]),
                **fields)
