# SPDX-License-Identifier: BSD-3-Clause
"""A sampled system as a feedback at the tick's rate sees it: one voltage, one mean a tick."""

import numpy as np

from piezo_common.arrays import FloatArray


def lift(a: FloatArray, b: FloatArray, c: FloatArray, samples_per_tick: int,
         delay_ticks: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lift a sampled system to the tick, with its averaging and its delay.

    What is known in tick k is the mean of the samples of tick k - 1. The input that is decided in
    tick k acts over tick k + `delay_ticks`, held for all its samples.

    Parameters
    ----------
    a, b, c : ndarray, shape (n, n), (n, 1), (1, n)
        Strictly proper, at the sample clock's period.

    Returns
    -------
    a, b, c : ndarray, shape (m, m), (m, 1), (1, m)
        At the tick's period, m = n + 1 + `delay_ticks`. States: those of the system at the start
        of the tick, the mean known, the inputs decided that have not acted, the oldest first.
    """
    order, size = len(a), len(a) + 1 + delay_ticks
    power, held, mean, through = np.eye(order), np.zeros_like(b), np.zeros_like(c), 0.0
    for _ in range(samples_per_tick):
        mean = mean + c @ power / samples_per_tick
        through = through + (c @ held).item() / samples_per_tick
        held = a @ held + b
        power = a @ power
    acting = np.r_[held[:, 0], through]
    lifted_a, lifted_b, lifted_c = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1, size))
    lifted_a[:order, :order], lifted_a[order, :order] = power, mean[0]
    if delay_ticks:
        lifted_a[:order + 1, order + 1] = acting
        lifted_a[order + 1:-1, order + 2:] = np.eye(delay_ticks - 1)
        lifted_b[-1, 0] = 1.0
    else:
        lifted_b[:order + 1, 0] = acting
    lifted_c[0, order] = 1.0
    return lifted_a, lifted_b, lifted_c
