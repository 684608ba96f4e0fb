# SPDX-License-Identifier: BSD-3-Clause
"""Order reduction of a controller by balanced truncation."""

import warnings
from collections.abc import Callable

import control
from slycot import ab09ad
from slycot.exceptions import SlycotResultWarning

from piezo_controller.feedback.synthesis.h_infinity import is_stable


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
