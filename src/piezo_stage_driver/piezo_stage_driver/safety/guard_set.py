# SPDX-License-Identifier: BSD-3-Clause
"""All guards of a stage together."""

from collections.abc import Mapping, Sequence

import numpy as np

from piezo_stage_driver.engine.sources import Volts
from piezo_stage_driver.safety.guards import FeedbackOscillation, SensorGuard, Stretch
from piezo_stage_driver.safety.sample_kernels import columns

FeedbackGuard = FeedbackOscillation | Mapping[str, FeedbackOscillation] | None
SensorGuards = Sequence[SensorGuard] | Mapping[str, Sequence[SensorGuard]]


class GuardSet:
    """Examine with all guards, and report the first cause of a stop.

    The guards of the sensor examine every stretch of samples; for several axes they are those of
    each axis by its name, in the order of the columns. The guard of the feedback, of each axis if
    there are several, examines every answer before it acts.
    """

    def __init__(self, sensor_guards: SensorGuards = (), feedback_guard: FeedbackGuard = None):
        self._by_axis = (sensor_guards if isinstance(sensor_guards, Mapping)
                         else {"": sensor_guards})
        self._feedback_guards: Mapping[str, FeedbackOscillation] = (
            feedback_guard if isinstance(feedback_guard, Mapping)
            else {"": feedback_guard} if feedback_guard else {})

    def begin(self) -> None:
        """Reset the guards; called when a program begins."""
        for guards in self._by_axis.values():
            for guard in guards:
                guard.begin()
        for feedback_guard in self._feedback_guards.values():
            feedback_guard.begin()

    def examine_feedback(self, voltage_v: Volts) -> str:
        """Return what is wrong with the next feedback (V); empty if nothing is."""
        causes = [_named(axis, guard.examine(of_axis_v)) for (axis, guard), of_axis_v in zip(
            self._feedback_guards.items(), np.atleast_1d(voltage_v), strict=False)]
        return next(filter(None, causes), "")

    def examine_samples(self, voltage_v: np.ndarray, displacement_um: np.ndarray,
                        samples_per_tick: int) -> str:
        """Return what is wrong with samples of whole ticks, (n,) or (n, axes); may be empty."""
        causes = []
        for (axis, guards), of_axis_v, of_axis_um in zip(
                self._by_axis.items(), columns(voltage_v), columns(displacement_um), strict=True):
            stretch = Stretch.of(of_axis_v, of_axis_um, samples_per_tick)
            # Each guard must examine every stretch, also after another one has found a cause.
            causes += [_named(axis, guard.examine(stretch)) for guard in guards]
        return next(filter(None, causes), "")


def _named(axis: str, cause: str) -> str:
    """Return a cause with the name of the axis, if both are known."""
    return f"{axis}: {cause}" if cause and axis else cause
