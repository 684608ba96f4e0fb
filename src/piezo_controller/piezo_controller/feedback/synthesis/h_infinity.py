# SPDX-License-Identifier: BSD-3-Clause
"""Discrete H-infinity synthesis: the controller of smallest norm, and of fewer states."""

import warnings
from collections.abc import Callable

import control
import numpy as np
from slycot import ab09ad, sb10dd
from slycot.exceptions import SlycotArithmeticError, SlycotResultWarning

STEP_BACK = 0.01


class NoController(ValueError):
    """There is no stabilising controller with a closed-loop norm below the largest norm tried."""


def synthesise(plant: control.StateSpace, slack: float = 0.0, largest_norm: float = 100.0,
               tolerance: float = 1e-4, axes: int = 1) -> tuple[control.StateSpace, float]:
    """Find the H-infinity (sub)optimal controller of a generalised plant by bisection.

    The plant is discrete. Its last inputs are the controls, one for each axis, and its last outputs
    are the measurements. Only stable controllers are accepted: an unstable one could not be at rest
    before a run, nor when the voltage is limited. Returned with the controller is the upper bound
    of the norm of the closed loop (gamma). Raises `NoController` if no controller reaches even
    `largest_norm`.

    `slack` is the part of the smallest norm that is given up. The optimal controller levels the
    closed loop over all frequencies, if necessary with lightly damped poles; a little slack avoids
    that. The bisection ends at the relative width `tolerance`.
    """
    upper, lower = largest_norm, 0.0
    best = _admissible(plant, upper, axes)
    if best is None:
        raise NoController(f"no stabilising controller keeps the closed loop below "
                           f"{largest_norm:g}: relax the weights")
    while upper - lower > tolerance * upper:
        # The geometric mean first finds the order of magnitude.
        middle = np.sqrt(upper * max(lower, 1e-3 * upper))
        candidate = _admissible(plant, middle, axes)
        if candidate is None:
            lower = middle
        else:
            upper, best = middle, candidate
    if slack:
        upper *= 1 + slack
        best = _admissible(plant, upper, axes) or best
    # The formulas lose digits close to the optimum, so the bound is relaxed until it holds.
    while control.linfnorm(close(plant, best))[0] > (1 + tolerance) * upper:
        upper *= 1 + STEP_BACK
        best = _admissible(plant, upper, axes) or best
    return best, upper


def close(plant: control.StateSpace, controller: control.StateSpace) -> control.StateSpace:
    """Close the loop of a generalised plant: the lower linear fractional transformation.

    The result leads from the exogenous inputs to the regulated outputs.
    """
    return plant.lft(controller, nu=controller.noutputs, ny=controller.ninputs)


def is_stable(system: control.StateSpace) -> bool:
    """Return whether all poles of a discrete system lie inside the unit circle."""
    return bool(np.abs(system.poles()).max(initial=0.0) < 1.0)


def _admissible(plant: control.StateSpace, norm: float, axes: int) -> control.StateSpace | None:
    """Return the controller for one bound; None if there is none."""
    outputs, inputs = plant.D.shape
    try:
        _, *matrices = sb10dd(plant.nstates, inputs, outputs, axes, axes, norm,
                              plant.A, plant.B, plant.C, plant.D)[:5]
    except SlycotArithmeticError:
        return None
    controller = control.ss(*matrices, plant.dt)
    stable = is_stable(controller) and is_stable(close(plant, controller))
    return controller if stable else None


def reduce_order(controller: control.StateSpace,
                 acceptable: Callable[[control.StateSpace], bool]) -> control.StateSpace:
    """Return the controller of lowest order that is still acceptable; itself if no other one is.

    The order of the discrete and stable controller is lowered step by step until a controller is
    not acceptable.
    """
    best = controller
    for order in range(controller.nstates - 1, 0, -1):
        candidate = _truncate(controller, order)
        if not (is_stable(candidate) and acceptable(candidate)):
            break
        best = candidate
    return best


def _truncate(system: control.StateSpace, order: int) -> control.StateSpace:
    with warnings.catch_warnings():
        # An order above that of a minimal realisation is lowered to it, which is intended.
        warnings.simplefilter("ignore", SlycotResultWarning)
        _, a, b, c, _ = ab09ad("D", "B", "N", system.nstates, system.ninputs, system.noutputs,
                               system.A, system.B, system.C, nr=order)
    return control.ss(a, b, c, system.D, system.dt)
