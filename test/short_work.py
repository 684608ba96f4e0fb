# SPDX-License-Identifier: BSD-3-Clause
"""Work without what takes longer than what tests look at: pictures and long searches."""

import os

from matplotlib.figure import Figure
from short_design import FEW_SCALINGS
from short_identification import (
    FEW_EFFECTS,
    FEW_POLES,
    FEW_WAVEFORMS,
    GIVEN_DENSITY,
    SHORT_PERIODS,
    WITHOUT_SEARCH,
)
from undrawn import save_point

from piezo_common import report_page, side_by_side

UNDRAWN = ((Figure, "savefig", save_point), (report_page, "interactive_item", lambda *_: None),
           (side_by_side, "cores", lambda: 1))


def work_shortly() -> None:
    """Let this process draw nothing, use one core, and search at length only by ``make long``."""
    short = () if os.environ.get("LONG_TESTS") else (
        *FEW_SCALINGS, *FEW_POLES, *WITHOUT_SEARCH, *GIVEN_DENSITY, *FEW_EFFECTS,
        *FEW_WAVEFORMS, *SHORT_PERIODS)
    for owner, name, instead in (*UNDRAWN, *short):
        assert hasattr(owner, name), f"{owner} has no {name} any more"
        setattr(owner, name, instead)
