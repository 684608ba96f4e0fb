# SPDX-License-Identifier: BSD-3-Clause
"""The loop without messages: a run over the backend of a stage, tick by tick."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.tracking.tracking_run import TrackingRun


@dataclass(frozen=True)
class PlayedRun:
    """What was played and measured, sample by sample, from the run's first sample on.

    Attributes
    ----------
    voltage_v, feedback_v, displacement_um : ndarray, shape (N,)
        All of the voltage; the feedback's part of it; measured.
    """

    voltage_v: np.ndarray
    feedback_v: np.ndarray
    displacement_um: np.ndarray


def play_run(run: TrackingRun, plan: FeedforwardPlan,
             exchange: Callable[[FloatArray], FloatArray], samples_per_tick: int) -> PlayedRun:
    """Play a run to its end, with the timing of the stage.

    The answer to the samples of a tick, computed in the next tick, acts in the one after that.

    Parameters
    ----------
    run : TrackingRun
    plan : FeedforwardPlan
        That of the run.
    exchange : callable
        Plays voltages, shape (n,), and returns the displacements measured at their start: that
        of a stage's backend.
    samples_per_tick : int

    Returns
    -------
    PlayedRun
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
