# SPDX-License-Identifier: BSD-3-Clause
"""The feedback while learning: it keeps the mean and leaves the period to the learning."""

import control
import numpy as np

from piezo_controller.feedback.feedback_design import FeedbackController, feedback_from_control
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_models.cascade import StageModel

BANDWIDTH_HZ = 8.0
# Of the second integration, which lets creep and drift leave no error, below the bandwidth.
SEPARATION = 4.0


def design_integral_feedback(model: StageModel, tick_s: float = 1e-3, clock_period_s: float = 25e-6,
                             model_sha256: str = "") -> FeedbackController:
    """Design two integrations below the frequencies of what is learned.

    A fast feedback amplifies errors about its bandwidth, where what it makes of a correction hangs
    on the hysteresis' gain as well; a slow one passes them, and a correction, nearly as they are.

    Parameters
    ----------
    model_sha256 : str
        Hash of the model's file.

    Raises
    ------
    UnstableLoop
        See `feedback_from_control`.
    """
    _, gain_um_per_v = design_plant(model, tick_s, clock_period_s)
    rate = 2 * np.pi * BANDWIDTH_HZ * tick_s
    first = control.tf([rate / gain_um_per_v, 0.0], [1.0, -1.0], tick_s)
    second = control.tf([1.0, rate / SEPARATION - 1.0], [1.0, -1.0], tick_s)
    return feedback_from_control(
        control.ss(first) * control.ss(second), model, clock_period_s, model_sha256, "integral")
