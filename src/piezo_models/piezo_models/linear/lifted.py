# SPDX-License-Identifier: BSD-3-Clause
"""A sampled system at the tick rate of a feedback: voltages and means of each tick."""

import numpy as np

from piezo_common.arrays import FloatArray


def lift(a: FloatArray, b: FloatArray, c: FloatArray, samples_per_tick: int,
         delay_ticks: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lift a sampled system to the tick rate, with its averaging and its delay.

    In tick k the mean of the samples of tick k - 1 is known. The input that is decided in tick k is
    held for all samples of tick k + `delay_ticks`. The system, with matrices (n, n), (n, i), (o,
    n), is strictly proper. The lifted one has m = n + o + i * `delay_ticks` states: those of the
    sampled system at the start of the tick, the known means, and the decided inputs that have not
    acted yet, the oldest first.
    """
    order, inputs, outputs = len(a), b.shape[1], len(c)
    known, size = order + outputs, order + outputs + inputs * delay_ticks
    power, held, mean = np.eye(order), np.zeros_like(b), np.zeros_like(c)
    through = np.zeros((outputs, inputs))
    for _ in range(samples_per_tick):
        mean = mean + c @ power / samples_per_tick
        through = through + c @ held / samples_per_tick
        held = a @ held + b
        power = a @ power
    acting = np.r_[held, through]
    lifted_a, lifted_b = np.zeros((size, size)), np.zeros((size, inputs))
    lifted_c = np.zeros((outputs, size))
    lifted_a[:order, :order], lifted_a[order:known, :order] = power, mean
    if delay_ticks:
        lifted_a[:known, known:known + inputs] = acting
        lifted_a[known:-inputs, known + inputs:] = np.eye(inputs * (delay_ticks - 1))
        lifted_b[-inputs:] = np.eye(inputs)
    else:
        lifted_b[:known] = acting
    lifted_c[:, order:known] = np.eye(outputs)
    return lifted_a, lifted_b, lifted_c
