# SPDX-License-Identifier: BSD-3-Clause
"""The stage as the feedback sees it: one voltage and one mean displacement a tick."""

import control

from piezo_models.linear.lifted import lift as lift_matrices


def lift(system: control.StateSpace, samples_per_tick: int,
         delay_ticks: int = 1) -> control.StateSpace:
    """Lift a fast discrete system to the tick, with its averaging and its computing time.

    The voltage that the controller decides in tick k acts over tick k + `delay_ticks`, held for
    all its samples; what it knows in tick k is the mean of the samples of tick k - 1.

    Parameters
    ----------
    system : control.StateSpace
        Strictly proper, one input, one output, at the sample clock's period.
    delay_ticks : int
        1 where somebody answers by a message, 0 where the stage evaluates the feedback by itself.

    Returns
    -------
    control.StateSpace
        From the voltage decided in a tick to the mean known in that tick, at the tick's period.
        States: those of `system` at the start of the tick, the mean known, the voltages acting.
    """
    a, b, c = lift_matrices(system.A, system.B, system.C, samples_per_tick, delay_ticks)
    return control.ss(a, b, c, 0.0, system.dt * samples_per_tick)
