# SPDX-License-Identifier: BSD-3-Clause
"""The feedback during learning: it holds the mean; the learning corrects the periodic part."""

import control
import numpy as np

from piezo_controller.feedback.feedback_design import FeedbackController, feedback_from_control
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_models.cascade import StageModel

BANDWIDTH_HZ = 8.0
# Ratio of the bandwidth to the second integration, which removes the error of creep and drift.
SEPARATION = 4.0


def design_integral_feedback(model: StageModel, tick_s: float = 1e-3, clock_period_s: float = 25e-6,
                             model_sha256: str = "") -> FeedbackController:
    """Design a double integrator with a bandwidth below the frequencies that are learned.

    A fast feedback amplifies errors near its bandwidth, where its response to a correction also
    depends on the hysteresis' gain. A slow one passes errors and corrections almost unchanged.
    Raises `UnstableLoop` as `feedback_from_control`.
    """
    _, gain_um_per_v = design_plant(model, tick_s, clock_period_s)
    rate = 2 * np.pi * BANDWIDTH_HZ * tick_s
    first = control.tf([rate / gain_um_per_v, 0.0], [1.0, -1.0], tick_s)
    second = control.tf([1.0, rate / SEPARATION - 1.0], [1.0, -1.0], tick_s)
    return feedback_from_control(
        control.ss(first) * control.ss(second), model, clock_period_s, model_sha256, "integral")
