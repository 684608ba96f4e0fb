# SPDX-License-Identifier: BSD-3-Clause
"""The stage as the feedback sees it: one voltage and one mean displacement a tick."""

import control
import numpy as np


def lift(system: control.StateSpace, samples_per_tick: int) -> control.StateSpace:
    """Lift a fast discrete system to the tick, with its averaging and its computing time.

    The voltage that the controller decides in tick k acts over tick k + 1, held for all its
    samples; what it knows in tick k is the mean of the samples of tick k - 1.

    Parameters
    ----------
    system : control.StateSpace
        Strictly proper, one input, one output, at the sample clock's period.
    samples_per_tick : int

    Returns
    -------
    control.StateSpace
        From the voltage decided in a tick to the mean known in that tick, at the tick's period.
        States: those of `system` at the start of the tick, the mean known, the voltage acting.
    """
    a, b, c = system.A, system.B, system.C
    power, held, mean, through = np.eye(len(a)), np.zeros_like(b), np.zeros_like(c), 0.0
    for _ in range(samples_per_tick):
        mean = mean + c @ power / samples_per_tick
        through = through + c @ held / samples_per_tick
        held = a @ held + b
        power = a @ power
    zero = np.zeros_like
    lifted_a = np.block([[power, zero(b), held],
                         [mean, np.zeros((1, 1)), through],
                         [zero(c), np.zeros((1, 2))]])
    lifted_b = np.zeros((len(lifted_a), 1))
    lifted_b[-1] = 1.0
    lifted_c = np.zeros((1, len(lifted_a)))
    lifted_c[0, -2] = 1.0
    return control.ss(lifted_a, lifted_b, lifted_c, 0.0, system.dt * samples_per_tick)
