# SPDX-License-Identifier: BSD-3-Clause
"""Every guard of a stage, examined together."""

from collections.abc import Sequence

import numpy as np

from piezo_stage_driver.safety.guards import FeedbackOscillation, SensorGuard, Stretch


class GuardSet:
    """Ask every guard, and tell the first cause of a stop.

    Parameters
    ----------
    sensor_guards : sequence of SensorGuard
        Examine every stretch of samples.
    feedback_guard : FeedbackOscillation, optional
        Examines every answer before it acts.
    """

    def __init__(self, sensor_guards: Sequence[SensorGuard] = (),
                 feedback_guard: FeedbackOscillation | None = None):
        self._sensor_guards, self._feedback_guard = sensor_guards, feedback_guard

    def begin(self) -> None:
        """Forget what was examined so far; called when a program begins."""
        for guard in self._sensor_guards:
            guard.begin()
        if self._feedback_guard is not None:
            self._feedback_guard.begin()

    def examine_feedback(self, voltage_v: float) -> str:
        """Say what is wrong with the feedback (V) that is to act next; empty if nothing is."""
        return self._feedback_guard.examine(voltage_v) if self._feedback_guard else ""

    def examine_samples(self, voltage_v: np.ndarray, displacement_um: np.ndarray,
                        samples_per_tick: int) -> str:
        """Say what is wrong with samples of whole ticks, shape (n,); empty if nothing is."""
        stretch = Stretch.of(voltage_v, displacement_um, samples_per_tick)
        # Each guard sees every stretch, whatever another one finds.
        causes = [guard.examine(stretch) for guard in self._sensor_guards]
        return next(filter(None, causes), "")
