# SPDX-License-Identifier: BSD-3-Clause
"""The feedback of a run as a law that the stage evaluates by itself."""

import math

import numpy as np

from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.multirate_feedback import observer_gain
from piezo_controller.feedback.synthesis.generalised_plant import (
    clock_plant,
    hysteresis_gain_range,
)
from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_models.cascade import StageModel
from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    InverseHysteresis,
    LinearBlock,
)

FADE_S = 0.02
"""Time over which the initial error is faded in (s): many times the response time of any loop of
this suite, and a part of the time before the run counts."""


def onboard_law(controller: FeedbackController, model: StageModel, plan: FeedforwardPlan,
                clock_period_s: float, max_feedback_v: float, before_inverse: bool = False,
                hold_inverse: bool = False, max_error_um: float = np.inf) -> FeedbackLaw:
    """Return a feedback as a law, together with the plan that it acts on.

    The controller is one for the model, with the period of the tick or of the sample clock. With
    `before_inverse`, it passes the inverse hysteresis together with the feedforward. Its report
    must then have the gain that it was designed for, else ValueError is raised. With `hold_inverse`
    in addition, the stage holds the mean of the inverse's voltages over a tick, as it holds the
    answer of a node. For the largest error of the law (um) see `FeedbackLaw`.
    """
    inverse = None
    if before_inverse:
        inverse = InverseHysteresis(
            model.hysteresis, controller.hysteresis_gain_um_per_v, hold_inverse)
    plant = clock_plant(model, clock_period_s)
    lowest, highest = hysteresis_gain_range(model)
    block = LinearBlock.of(controller.A, controller.B, controller.C, controller.D)
    if answers_samples(controller, clock_period_s):
        for _ in range(controller.delay_ticks):
            block = _one_later(block)
        tick, observer, sample = LinearBlock(), np.zeros(0), block
    else:
        tick, observer, sample = block, observer_gain(controller)[:, 0], LinearBlock()
    return FeedbackLaw(
        tick=tick, observer=observer, sample=sample, max_feedback_v=max_feedback_v,
        once_um=plan.reference_once_um, period_um=plan.reference_period_um,
        plant=DeclaredPlant(LinearBlock.of(plant.A, plant.B, plant.C, plant.D),
                            np.array([lowest, (lowest + highest) / 2, highest])),
        start_sample=plan.feedback_start_sample,
        delay_ticks=controller.delay_ticks if sample.empty else 0,
        inverse=inverse, max_error_um=max_error_um,
        fade_samples=round(FADE_S / clock_period_s))


def answers_samples(controller: FeedbackController, clock_period_s: float) -> bool:
    """Return whether a feedback has the period of the sample clock."""
    return math.isclose(controller.sample_period_s, clock_period_s, rel_tol=1e-6)


def _one_later(block: LinearBlock) -> LinearBlock:
    """Return a block whose output is delayed by one sample."""
    order = block.order
    a = np.zeros((order + 1, order + 1))
    a[:order, :order], a[order, :order] = block.a, block.c
    return LinearBlock(a, np.append(block.b, block.d), np.eye(order + 1)[order])
