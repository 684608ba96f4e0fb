# SPDX-License-Identifier: BSD-3-Clause
"""A running feedback law of several axes, which answers ticks; see `RunningLaw` for one axis."""

from collections import deque

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import FeedbackLaw


class RunningAxesLaw:
    """Evaluate a law of several axes from tick to tick, like `RunningLaw`.

    `largest_step_v` is the largest change of the feedback voltage of an axis from one tick to the
    next in V, and `stepped` is True if it limited the voltage of an axis. `error_um`, (axes,), is
    the mean error of the last tick, and `voltage_v`, (axes,), the feedback voltage in the present
    tick.
    """

    def __init__(self, law: FeedbackLaw, samples_per_tick: int,
                 largest_step_v: float = np.inf) -> None:
        self.law, self.samples_at_once, self._step_v = law, samples_per_tick, largest_step_v
        self._a, self._b, self._c, self._d = law.tick.matrices
        self._state, zeros = np.zeros(law.tick.order), np.zeros(len(law.axes))
        self.error_um, self.voltage_v, self.stepped = zeros, zeros, False
        self._expected_um = np.concatenate([law.once_um, law.period_um])
        # A tick is fed back as a whole.
        self._start_sample = -(-law.start_sample // samples_per_tick) * samples_per_tick
        self._measured, self._initial_um = 0, zeros
        self._decided_v, self._decisions = zeros, deque([zeros] * law.delay_ticks)

    @property
    def begun(self) -> bool:
        """Return True once a tick has been fed back."""
        return self._measured > self._start_sample

    def begin(self, planned_v: FloatArray) -> FloatArray:
        """Return the voltages to add to the planned voltages of a tick, shape (k, axes), in V."""
        self._decisions.append(self._decided_v)
        self.voltage_v = self._decisions.popleft()
        return np.broadcast_to(self.voltage_v, planned_v.shape)

    def correct(self, lacking_v: FloatArray) -> None:
        """Correct the state by the feedback voltage that was not played, shape (axes,), in V."""
        if self.begun:
            self.voltage_v = self.voltage_v + lacking_v
            self._state += self.law.observer @ lacking_v

    def take(self, displacement_um: FloatArray) -> None:
        """Process the measured samples of a tick, shape (k, axes), in um."""
        at = self._measured + np.arange(len(displacement_um))
        error_um = self._expected_um[self._place(at)] - displacement_um
        if self._measured == self._start_sample:
            self._initial_um = self.error_um if self._measured else error_um[0]
        self._measured += len(at)
        self.error_um = error_um.mean(axis=0)
        if self.begun:
            self._decide(self.error_um - self._fade(at) * self._initial_um)

    def _place(self, at: np.ndarray) -> np.ndarray:
        """Return where samples of the run are in `once_um` followed by `period_um`."""
        once, period = len(self.law.once_um), len(self.law.period_um)
        if not period:
            return np.minimum(at, once - 1)
        return np.where(at < once, at, once + (at - once) % period)

    def _fade(self, at: np.ndarray) -> float:
        """Return the mean share of the initial error that is not fed back yet."""
        if not self.law.fade_samples:
            return 0.0
        part = np.clip((at - self._start_sample) / self.law.fade_samples, 0.0, 1.0)
        return float(np.mean(1.0 - part**3 * (10.0 - 15.0 * part + 6.0 * part**2)))

    def _decide(self, seen_um: FloatArray) -> None:
        """Compute the voltages within the limits; what they cut off corrects the state."""
        limit_v, last_v = self.law.max_feedback_v, self._decided_v
        wanted_v = self._c @ self._state + self._d @ seen_um
        within_v = np.clip(wanted_v, -limit_v, limit_v)
        self._decided_v = np.clip(within_v, last_v - self._step_v, last_v + self._step_v)
        self.stepped = bool(np.any(self._decided_v != within_v))
        self._state = self._a @ self._state + self._b @ seen_um + self.law.observer @ (
            self._decided_v - wanted_v)
