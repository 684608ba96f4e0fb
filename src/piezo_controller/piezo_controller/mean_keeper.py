# SPDX-License-Identifier: BSD-3-Clause
"""The feedback while learning: it keeps the mean and leaves the period to the learning."""

import control
import numpy as np

from piezo_controller.feedback_design import FeedbackController
from piezo_controller.generalised_plant import design_plant, hysteresis_gain_range
from piezo_controller.loop_measures import measure_loop

BANDWIDTH_HZ = 8.0
# Of the second integration, which lets creep and drift leave no error, below the bandwidth.
SEPARATION = 4.0


def design_mean_keeper(model, tick_s=1e-3, clock_period_s=25e-6, model_sha256=""):
    """Design two integrations below the frequencies of what is learned.

    A fast feedback amplifies errors about its bandwidth, where what it makes of a correction hangs
    on the hysteresis' gain as well; a slow one passes them, and a correction, nearly as they are.

    Parameters
    ----------
    model : piezo_models.cascade.StageModel
    tick_s, clock_period_s : float
    model_sha256 : str
        Hash of the model's file.

    Returns
    -------
    FeedbackController
    """
    plant, gain_um_per_v = design_plant(model, tick_s, clock_period_s)
    rate = 2 * np.pi * BANDWIDTH_HZ * tick_s
    first = control.tf([rate / gain_um_per_v, 0.0], [1.0, -1.0], tick_s)
    second = control.tf([1.0, rate / SEPARATION - 1.0], [1.0, -1.0], tick_s)
    controller = control.ss(first) * control.ss(second)
    spread = hysteresis_gain_range(model)[1] / gain_um_per_v - 1
    report = {"method": "mean_keeper", "order": controller.nstates,
              "hysteresis_gain_um_per_v": gain_um_per_v, "hysteresis_gain_spread": spread,
              **measure_loop(gain_um_per_v * plant, controller, spread)}
    return FeedbackController(controller.A, controller.B, controller.C, controller.D, tick_s,
                              report, {}, model_sha256)
