# SPDX-License-Identifier: BSD-3-Clause
"""A sampled system at the tick rate of a feedback: one voltage and one mean for each tick."""

import numpy as np

from piezo_common.arrays import FloatArray


def lift(a: FloatArray, b: FloatArray, c: FloatArray, samples_per_tick: int,
         delay_ticks: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lift a sampled system to the tick rate, with its averaging and its delay.

    In tick k the mean of the samples of tick k - 1 is known. The input that is decided in tick k is
    held for all samples of tick k + `delay_ticks`.

    Parameters
    ----------
    a, b, c : ndarray, shape (n, n), (n, 1), (1, n)
        Strictly proper system at the sample rate.

    Returns
    -------
    a, b, c : ndarray, shape (m, m), (m, 1), (1, m)
        System at the tick rate, m = n + 1 + `delay_ticks`. Its states are those of the sampled
        system at the start of the tick, the known mean, and the decided inputs that have not acted
        yet, the oldest first.
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
