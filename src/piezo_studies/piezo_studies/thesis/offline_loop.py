# SPDX-License-Identifier: BSD-3-Clause
"""The control loop without messages: a run on the backend of a stage, tick by tick."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.feedback_law.running_law import RunningLaw


@dataclass(frozen=True)
class PlayedRun:
    """The played and measured samples of a run."""

    voltage_v: np.ndarray
    feedback_v: np.ndarray
    displacement_um: np.ndarray
    """Whole voltage, part of the feedback in it, and measured displacement, (N,)."""


def play_run(run: TrackingRun, plan: FeedforwardPlan,
             exchange: Callable[[FloatArray], FloatArray], samples_per_tick: int) -> PlayedRun:
    """Play a run to its end, with the timing of the stage.

    The feedback for the samples of a tick is computed in the next tick, and acts in the one after
    that. Like the backend of a stage, `exchange` plays voltages, (n,), and returns the
    displacements measured at their start.
    """
    ticks = -(-run.total_samples // samples_per_tick)
    planned_v = plan.voltage_v(0, ticks * samples_per_tick).reshape(ticks, samples_per_tick)
    displacement_um = np.empty_like(planned_v)
    feedback_v = np.zeros(ticks + 2)
    for tick in range(ticks):
        displacement_um[tick] = exchange(planned_v[tick] + feedback_v[tick])
        feedback_v[tick + 2] = run.take(displacement_um[tick])
    held_v = np.repeat(feedback_v[:ticks], samples_per_tick)
    return PlayedRun(planned_v.ravel() + held_v, held_v, displacement_um.ravel())


def play_law(run: TrackingRun, law: RunningLaw, plan: FeedforwardPlan,
             exchange: Callable[[FloatArray], FloatArray]) -> PlayedRun:
    """Play a run without feedback of its own with a control law that the stage evaluates.

    The law is in its initial state; for plan and exchange see `play_run`.
    """
    at_once = law.samples_at_once
    parts = -(-run.total_samples // at_once)
    planned_v = plan.voltage_v(0, parts * at_once).reshape(parts, at_once)
    feedback_v, displacement_um = np.empty((2, *planned_v.shape))
    for part in range(parts):
        feedback_v[part] = law.begin(planned_v[part])
        displacement_um[part] = exchange(planned_v[part] + feedback_v[part])
        law.take(displacement_um[part])
        run.take(displacement_um[part])
    return PlayedRun((planned_v + feedback_v).ravel(), feedback_v.ravel(),
                     displacement_um.ravel())
