# SPDX-License-Identifier: BSD-3-Clause
"""Feedback that passes the inverse hysteresis, as a part of the feedforward does.

Behind the inverse the hysteresis' gain is not uncertain: the loop has the gain of the model
alone. It takes an inversion in every tick.
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

    The stage adds one voltage to the feedforward for a whole tick. Given is the mean of what the
    inverse asks for in the tick's samples; the hysteresis' past is that of what is played.

    Parameters
    ----------
    controller : FeedbackController
        Designed for the nominal gain of the hysteresis, which is divided out.
    model : piezo_models.cascade.StageModel
        Whose hysteresis is inverted.
    plan : FeedforwardPlan
        What is played beside the feedback.
    max_feedback_v : float
        Largest voltage given, of either sign (V).
    rest_voltage_v : float
        Where the run begins (V).

    Raises
    ------
    ValueError
        The controller does not tell the gain that it was designed for.
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
