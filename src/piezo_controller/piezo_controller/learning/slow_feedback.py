# SPDX-License-Identifier: BSD-3-Clause
"""The feedback during learning: it holds the mean; the learning corrects the periodic part."""

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray
from piezo_controller.feedback.feedback_design import FeedbackController, feedback_from_control
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import zoh_response

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


def fast_sensitivity(model: StageModel, controller: FeedbackController, frequency_hz: ArrayLike,
                     clock_period_s: float = 25e-6) -> ComplexArray:
    """Return the response from the displacement without the slow feedback to that with it, (F,).

    The feedback sees the mean of a tick and answers with a held voltage. Only the part of its
    answer at the frequency itself counts, not its images at other multiples of the tick.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=float)
    tick_s = controller.sample_period_s
    plant, gain_um_per_v = design_plant(model, tick_s, clock_period_s)
    samples = round(tick_s / clock_period_s)
    at_tick = np.exp(2j * np.pi * frequency_hz * tick_s)
    answer = controller.state_space()(at_tick, squeeze=False)[0, 0]
    loop = gain_um_per_v * plant(at_tick, squeeze=False)[0, 0] * answer
    # The mean of the previous tick is known in a tick; the answer is held over the next one.
    turns = np.exp(-2j * np.pi * clock_period_s * np.outer(frequency_hz, np.arange(samples)))
    mean = turns.conj().mean(axis=1) / at_tick
    held = turns.mean(axis=1) / at_tick
    through = gain_um_per_v * zoh_response(model.linear(), frequency_hz, clock_period_s)
    return 1.0 - through * held * answer * mean / (1.0 + loop)
