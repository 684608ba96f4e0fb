# SPDX-License-Identifier: BSD-3-Clause
"""How long the feedback takes to answer one block, on this machine."""

import time

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.multirate_feedback import MultirateFeedback

REPEATS = 2000
WARM_UP = 200
USUAL_ORDER = 15
PERCENTILE = 99.0


def answer_times_s(feedback: MultirateFeedback, samples_per_tick: int,
                   repeats: int = REPEATS) -> FloatArray:
    """Measure the answers to blocks of noise.

    Parameters
    ----------
    feedback : MultirateFeedback
        Is reset afterwards.
    samples_per_tick, repeats : int

    Returns
    -------
    ndarray, shape (repeats,)
        Seconds of each answer, after some that are not counted.
    """
    expected_um = np.zeros(samples_per_tick)
    blocks_um = 1e-3 * np.random.default_rng(0).standard_normal((WARM_UP + repeats,
                                                                  samples_per_tick))
    taken_s = np.empty(len(blocks_um))
    for index, block_um in enumerate(blocks_um):
        begin_s = time.perf_counter()
        feedback.step(expected_um, block_um)
        taken_s[index] = time.perf_counter() - begin_s
    feedback.reset()
    return taken_s[WARM_UP:]


def computing_time_s(samples_per_tick: int = 40, order: int = USUAL_ORDER) -> float:
    """Measure the 99th percentile of the answers of a controller of some order (s)."""
    controller = control.ss(0.5 * np.eye(order), np.ones((order, 1)), np.ones((1, order)), 0.0,
                            True)
    times_s = answer_times_s(MultirateFeedback(controller), samples_per_tick)
    return float(np.percentile(times_s, PERCENTILE))
