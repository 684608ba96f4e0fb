# SPDX-License-Identifier: BSD-3-Clause
"""Feedback that passes the inverse hysteresis together with the feedforward.

Before the inverse the gain of the hysteresis is not uncertain: the loop has the gain of the model
alone. This costs one inversion per tick.
"""

import math

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.feedback_law import InverseHysteresis
from piezo_models.feedback_law.running_inverse import RunningInverse


class FeedbackBeforeInverse:
    """Runs a feedback controller whose answers are hysteresis outputs instead of voltages.

    The stage adds one voltage to the feedforward for a whole tick. It is the mean over the tick's
    samples of what the inverse gives, with the hysteresis' memory of the voltage that is played.
    The nominal gain of the hysteresis, for which the controller was designed, is divided out.
    Raises ValueError if the controller's report lacks the gain that it was designed for.
    """

    def __init__(self, controller: FeedbackController, model: StageModel, plan: FeedforwardPlan,
                 samples_per_tick: int, max_feedback_v: float = 20.0,
                 rest_voltage_v: float = 0.0) -> None:
        self._feedback = MultirateFeedback(controller, max_feedback_v)
        gain_um_per_v = controller.hysteresis_gain_um_per_v
        self._max_v = float(max_feedback_v)
        self._plan = plan
        self._samples = samples_per_tick
        first_block = math.ceil(plan.feedback_start_sample / samples_per_tick)
        # The answer to a block acts when the block after the next begins.
        self._next_sample = (first_block + 2) * samples_per_tick
        self._inverse = RunningInverse(InverseHysteresis(
            model.hysteresis, gain_um_per_v, held=True), rest_voltage_v)
        self._inverse.follow(plan.voltage_v(0, self._next_sample))

    def step(self, expected_um: FloatArray | float, displacement_um: FloatArray | float) -> float:
        """Answer the block of one tick; see `MultirateFeedback.step`."""
        wanted_v = self._feedback.step(expected_um, displacement_um)
        planned_v = self._plan.voltage_v(self._next_sample, self._samples)
        self._next_sample += self._samples
        voltage_v, _ = self._inverse.pass_on(
            wanted_v, planned_v, -self._max_v, self._max_v, np.empty(self._samples))
        return voltage_v
