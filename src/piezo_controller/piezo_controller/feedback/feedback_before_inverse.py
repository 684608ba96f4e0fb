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


class FeedbackBeforeInverse:
    """Runs a feedback controller whose answers are hysteresis outputs instead of voltages.

    The stage adds one voltage to the feedforward for a whole tick. It is the mean over the tick's
    samples of what the inverse gives, with the hysteresis' memory of the voltage that is played.
    The nominal gain of the hysteresis, for which the controller was designed, is divided out.

    Raises
    ------
    ValueError
        If the controller's report lacks the gain that it was designed for.
    """

    def __init__(self, controller: FeedbackController, model: StageModel, plan: FeedforwardPlan,
                 samples_per_tick: int, max_feedback_v: float = 20.0,
                 rest_voltage_v: float = 0.0) -> None:
        self._gain_um_per_v = controller.hysteresis_gain_um_per_v
        self._feedback = MultirateFeedback(controller, max_feedback_v)
        self._max_v = float(max_feedback_v)
        self._hysteresis = model.hysteresis
        self._plan = plan
        self._samples = samples_per_tick
        first_block = math.ceil(plan.feedback_start_sample / samples_per_tick)
        # The answer to a block acts when the block after the next begins.
        self._next_sample = (first_block + 2) * samples_per_tick
        self._played = model.memory(rest_voltage_v).hysteresis
        self._hysteresis.simulate(plan.voltage_v(0, self._next_sample), self._played)
        self._planned = self._played.copy()

    def step(self, expected_um: FloatArray | float, displacement_um: FloatArray | float) -> float:
        """Answer the block of one tick; see `MultirateFeedback.step`."""
        wanted_um = self._gain_um_per_v * self._feedback.step(expected_um, displacement_um)
        planned_v = self._plan.voltage_v(self._next_sample, self._samples)
        self._next_sample += self._samples
        planned_um = self._hysteresis.simulate(planned_v, self._planned)
        target_um = np.clip(planned_um + wanted_um, *self._hysteresis.output_range_um)
        inverse_v = self._hysteresis.invert(target_um, self._played.copy())
        voltage_v = float(np.clip(np.mean(inverse_v - planned_v), -self._max_v, self._max_v))
        self._hysteresis.simulate(planned_v + voltage_v, self._played)
        return voltage_v
