# SPDX-License-Identifier: BSD-3-Clause
"""Effect of the slow feedback on a fast error of the feedforward."""

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import zoh_response


def fast_sensitivity(model: StageModel, controller: FeedbackController, frequency_hz: ArrayLike,
                     clock_period_s: float = 25e-6) -> ComplexArray:
    """Return the response from the displacement without feedback to that with it, (F,).

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
