# SPDX-License-Identifier: BSD-3-Clause
"""The feedback of a run as a law that the stage evaluates by itself."""

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


def onboard_law(controller: FeedbackController, model: StageModel, plan: FeedforwardPlan,
                clock_period_s: float, max_feedback_v: float, before_inverse: bool = False,
                hold_inverse: bool = False, max_error_um: float = np.inf) -> FeedbackLaw:
    """Describe a feedback and what it was designed for.

    Parameters
    ----------
    controller : FeedbackController
    model : piezo_models.cascade.StageModel
        That it was designed for.
    plan : FeedforwardPlan
        What is played beside it.
    clock_period_s : float
    max_feedback_v : float
        Largest voltage given, of either sign (V).
    before_inverse : bool
        Whether it passes the inverse hysteresis together with the feedforward.
    hold_inverse : bool
        Whether the stage then holds the mean over a tick of what the inverse asks for, as it holds
        the answer of a node.
    max_error_um : float
        See `FeedbackLaw`.

    Returns
    -------
    FeedbackLaw

    Raises
    ------
    ValueError
        The controller does not tell the gain that it was designed for, but is to be divided by it.
    """
    inverse = None
    if before_inverse:
        inverse = InverseHysteresis(
            model.hysteresis, controller.hysteresis_gain_um_per_v, hold_inverse)
    plant = clock_plant(model, clock_period_s)
    lowest, highest = hysteresis_gain_range(model)
    return FeedbackLaw(
        tick=LinearBlock.of(controller.A, controller.B, controller.C, controller.D),
        observer=observer_gain(controller), max_feedback_v=max_feedback_v,
        once_um=plan.reference_once_um, period_um=plan.reference_period_um,
        plant=DeclaredPlant(LinearBlock.of(plant.A, plant.B, plant.C, plant.D),
                            np.array([lowest, (lowest + highest) / 2, highest])),
        start_sample=plan.feedback_start_sample, delay_ticks=controller.delay_ticks,
        inverse=inverse, max_error_um=max_error_um)
