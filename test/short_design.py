# SPDX-License-Identifier: BSD-3-Clause
"""A shorter design of a feedback, for tests that take the design as given."""

from functools import partial

import numpy as np

from piezo_controller.feedback import loop_measures
from piezo_controller.feedback.synthesis import dk_iteration

FEW_SCALINGS = (
    (dk_iteration, "tick_frequencies", partial(dk_iteration.tick_frequencies, count=20)),
    (dk_iteration, "SEARCHED", 1), (dk_iteration, "ITERATIONS", 2),
    (loop_measures, "_frequencies", lambda tick_s: np.geomspace(0.1, 0.5 / tick_s, 1000)))
"""The structured singular value has a third of the frequencies, and the loop is measured at an
eighth of them."""
