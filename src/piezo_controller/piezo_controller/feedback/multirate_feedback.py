# SPDX-License-Identifier: BSD-3-Clause
"""The feedback at run time: one error in, one voltage out, every tick."""

import control
import numpy as np
from scipy.linalg import solve_discrete_are

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController


class MultirateFeedback:
    """Runs a feedback controller tick by tick with a limited voltage of either sign (V).

    If the limit applies, an observer keeps the controller's state consistent with the limited
    voltage (anti-windup). Raises ValueError if the limit is not positive.
    """

    def __init__(self, controller: FeedbackController | control.StateSpace,
                 max_feedback_v: float = 20.0) -> None:
        if not max_feedback_v > 0:
            raise ValueError(f"max_feedback_v is {max_feedback_v:g}: give a positive voltage")
        self._a = np.ascontiguousarray(controller.A)
        self._b = np.ravel(controller.B)
        self._c = np.ravel(controller.C)
        self._d = float(np.squeeze(controller.D))
        self._observer = observer_gain(controller)[:, 0]
        self._max_v = float(max_feedback_v)
        self.reset()

    def reset(self) -> None:
        """Reset the controller's state."""
        self._state = np.zeros(len(self._a))

    def step(self, expected_um: FloatArray | float, displacement_um: FloatArray | float) -> float:
        """Answer the block of one tick by the voltage (V) of the tick after its computation.

        Reference and measured displacement of the tick's samples (um), (n,), may be given by their
        means.
        """
        error_um = np.mean(expected_um) - np.mean(displacement_um)
        wanted_v = float(self._c @ self._state + self._d * error_um)
        voltage_v = min(max(wanted_v, -self._max_v), self._max_v)
        self._state = (self._a @ self._state + self._b * error_um
                       + self._observer * (voltage_v - wanted_v))
        return voltage_v


def observer_gain(controller: FeedbackController | control.StateSpace) -> FloatArray:
    """Return the gain that corrects the state by the parts of the voltages that were cut off.

    It is that of the Kalman predictor for unknown errors of 1 um and voltages known to 1 V, shape
    (n, outputs).
    """
    a, b, c, d = (np.atleast_2d(m) for m in (controller.A, controller.B, controller.C,
                                             controller.D))
    output_noise = d @ d.T + np.eye(len(d))
    covariance = solve_discrete_are(a.T, c.T, b @ b.T, output_noise, s=b @ d.T)
    gain: FloatArray = np.linalg.solve(
        c @ covariance @ c.T + output_noise, (a @ covariance @ c.T + b @ d.T).T).T
    return gain
