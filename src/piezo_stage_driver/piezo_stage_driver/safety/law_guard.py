# SPDX-License-Identifier: BSD-3-Clause
"""A guard that stops a feedback law whose declared model does not match the stage."""

from collections import deque

import numpy as np

from piezo_models.feedback_law.feedback_law import FeedbackLaw
from piezo_models.feedback_law.law_check import OTHER_GAIN

# With less travel of the voltage the gain cannot be distinguished from the sensor's noise.
LEAST_TRAVEL_V = 5.0
# Ticks before the feedback begins; before them the memory of the hysteresis may be unknown.
WATCHED_TICKS = 50


class LawGuard:
    """Compare a stage with the model that a law declares, then watch the error of the law.

    Before the feedback begins, the stage is moved by its feedforward, which reveals its gain. A law
    that was designed for another gain is stopped before it acts. Of a law of several axes, one is
    watched.
    """

    def __init__(self, law: FeedbackLaw, axis: int = 0) -> None:
        gains = np.atleast_2d(np.transpose(law.plant.gains_um_per_v))[axis]
        self._gains_um_per_v = float(gains.min()), float(gains.max())
        self._max_error_um = law.max_error_um
        self._errors_um: deque[float] = deque([0.0], maxlen=WATCHED_TICKS)
        self._lowest = np.full(2, np.inf)
        self._highest = np.full(2, -np.inf)
        self._bound_um: float | None = None

    def of_next(self, law: FeedbackLaw) -> "LawGuard":
        """Return the guard of a law that replaces this one during a run, with the same state."""
        guard = LawGuard(law)
        guard._max_error_um = min(guard._max_error_um, self._max_error_um)
        guard._errors_um, guard._lowest, guard._highest = (
            self._errors_um, self._lowest, self._highest)
        return guard

    def watch(self, voltage_v: np.ndarray, displacement_um: np.ndarray, error_um: float) -> None:
        """Take the samples, shape (n,), and the mean error of a tick before the feedback begins."""
        means = np.array((voltage_v.mean(), displacement_um.mean()))
        self._lowest = np.minimum(self._lowest, means)
        self._highest = np.maximum(self._highest, means)
        self._errors_um.append(abs(error_um))

    def examine(self, error_um: float) -> str:
        """Return what is wrong with the mean error of a tick with feedback; empty if nothing is."""
        if self._bound_um is None:
            self._bound_um = max(self._errors_um) + self._max_error_um
            cause = self._compare_gain()
            if cause:
                return cause
        if abs(error_um) <= self._bound_um:
            return ""
        return (f"the feedback law has an error of {abs(error_um):.3g} um, more than "
                f"{self._bound_um:.3g} um: settle the stage (stage settle) and track again; if "
                "that recurs, identify it again")

    def _compare_gain(self) -> str:
        travel_v, travel_um = self._highest - self._lowest
        lowest, highest = self._gains_um_per_v
        gain = travel_um / travel_v if travel_v >= LEAST_TRAVEL_V else lowest
        if lowest / OTHER_GAIN <= gain <= highest * OTHER_GAIN:
            return ""
        return (f"the stage moved by {gain:.3g} um/V, and the feedback law declares {lowest:.3g} "
                f"to {highest:.3g} um/V: design it for this stage")


class AxesLawGuard:
    """The guards of all axes of a law; a cause names the axis."""

    def __init__(self, law: FeedbackLaw) -> None:
        self._guards = {axis: LawGuard(law, at) for at, axis in enumerate(law.axes)}
        gains_um_per_v = np.mean(law.plant.gains_um_per_v, axis=0)
        at_rest = law.plant.linear.response(np.ones(1, dtype=complex))[0].real
        self._alone = at_rest * gains_um_per_v / (at_rest.diagonal() * gains_um_per_v)[:, None]

    def watch(self, voltage_v: np.ndarray, displacement_um: np.ndarray,
              error_um: np.ndarray) -> None:
        """Take the samples and mean errors of a tick, shape (n, axes) and (axes,)."""
        # Voltages that would move each axis as far without those of the others.
        alone_v = voltage_v @ self._alone.T
        for at, guard in enumerate(self._guards.values()):
            guard.watch(alone_v[:, at], displacement_um[:, at], error_um[at])

    def examine(self, error_um: np.ndarray) -> str:
        """Return what is wrong with the mean errors of a tick; empty if nothing is."""
        causes = [(axis, guard.examine(float(of_axis_um))) for (axis, guard), of_axis_um in zip(
            self._guards.items(), error_um, strict=True)]
        return next((f"{axis}: {cause}" for axis, cause in causes if cause), "")
