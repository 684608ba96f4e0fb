# SPDX-License-Identifier: BSD-3-Clause
"""Work without what takes longer than what tests look at: pictures and long searches."""

import os
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from short_identification import FEW_EFFECTS, FEW_POLES, GIVEN_DENSITY, WITHOUT_SEARCH
from undrawn import save_point

from piezo_common import report_page, side_by_side
from piezo_controller.feedback import loop_measures
from piezo_controller.feedback.synthesis import dk_iteration

UNDRAWN = ((Figure, "savefig", save_point), (report_page, "interactive_item", lambda *_: None),
           (side_by_side, "cores", lambda: 1))
FEW_SCALINGS = (
    (dk_iteration, "tick_frequencies", partial(dk_iteration.tick_frequencies, count=20)),
    (dk_iteration, "SEARCHED", 1), (dk_iteration, "ITERATIONS", 2),
    (loop_measures, "_frequencies", lambda tick_s: np.geomspace(0.1, 0.5 / tick_s, 1000)))
"""Of a design of a feedback, whose structured singular value has a third of the frequencies, and
whose loop is measured at an eighth of them."""


def work_shortly() -> None:
    """Let this process draw nothing, use one core, and search at length only by ``make long``."""
    short = () if os.environ.get("LONG_TESTS") else (
        *FEW_SCALINGS, *FEW_POLES, *WITHOUT_SEARCH, *GIVEN_DENSITY, *FEW_EFFECTS)
    for owner, name, instead in (*UNDRAWN, *short):
        assert hasattr(owner, name), f"{owner} has no {name} any more"
        setattr(owner, name, instead)
