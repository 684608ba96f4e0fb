# SPDX-License-Identifier: BSD-3-Clause
"""Time that the feedback takes to answer one block on this machine."""

import time
from collections.abc import Callable

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.multirate_feedback import MultirateFeedback

REPEATS = 2000
WARM_UP = 200
USUAL_ORDER = 15
SAMPLES_PER_TICK = 40
PERCENTILE = 99.0


def answer_times_s(feedback: MultirateFeedback, samples_per_tick: int,
                   repeats: int = REPEATS,
                   clock_s: Callable[[], float] = time.perf_counter) -> FloatArray:
    """Time the answers to blocks of noise (s), shape (repeats,), without some to warm up.

    The feedback is reset afterwards.
    """
    expected_um = np.zeros(samples_per_tick)
    blocks_um = 1e-3 * np.random.default_rng(0).standard_normal((WARM_UP + repeats,
                                                                  samples_per_tick))
    taken_s = np.empty(len(blocks_um))
    for index, block_um in enumerate(blocks_um):
        begin_s = clock_s()
        feedback.step(expected_um, block_um)
        taken_s[index] = clock_s() - begin_s
    feedback.reset()
    return taken_s[WARM_UP:]


def computing_time_s() -> float:
    """Return the 99th percentile of the answer times of a controller of the usual order (s).

    Processor time is counted, so that a design comes out the same on a busy computer.
    """
    controller = control.ss(0.5 * np.eye(USUAL_ORDER), np.ones((USUAL_ORDER, 1)),
                            np.ones((1, USUAL_ORDER)), 0.0, True)
    times_s = answer_times_s(
        MultirateFeedback(controller), SAMPLES_PER_TICK, clock_s=time.thread_time)
    return float(np.percentile(times_s, PERCENTILE))
