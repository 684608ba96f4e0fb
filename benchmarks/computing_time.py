# SPDX-License-Identifier: BSD-3-Clause
"""Measure what the answer to a tick takes to compute, without any message."""

import time

import numpy as np
from stage_model import stage_model

from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.tracking.tracking_run import TrackingRun

SAMPLES_PER_TICK = 40
TICKS = 5000
WARM_UP = 200


def computing_times_s():
    """Return the times (s) of the answers of the run's account with its feedback, by its order.

    The orders are the thesis' 15, and what the reduction leaves of the default.
    """
    model = stage_model()
    plan = plan_feedforward(np.full(SAMPLES_PER_TICK, 50.0), model, duration_s=0.1)
    controllers = (
        design_feedback(model, load_weights("thesis"), at_once=True, reduce=False),
        design_feedback(model, load_weights()))
    return {controller.report["order"]: _times_s(plan, controller) for controller in controllers}


def _times_s(plan, controller):
    run = TrackingRun(plan, (WARM_UP + TICKS) * SAMPLES_PER_TICK, MultirateFeedback(controller))
    blocks_um = 50.0 + 0.01 * np.random.default_rng(1).standard_normal(
        (run.total_samples // SAMPLES_PER_TICK, SAMPLES_PER_TICK))
    times_s = np.empty(len(blocks_um))
    for index, block_um in enumerate(blocks_um):
        begin_s = time.perf_counter()
        run.take(block_um)
        times_s[index] = time.perf_counter() - begin_s
    return times_s[-TICKS:]
