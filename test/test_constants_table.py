# SPDX-License-Identifier: BSD-3-Clause
"""docs/constants.md lists the numbers that identification and diagnosis decide by."""

from pathlib import Path

import constants_table

ROOT = Path(__file__).parents[1]

MODULE = '''
LONGEST_S, FACTOR = 2.5, -3
"""How long it lasts, and by how much. Set on 40 drawn stages."""

NAMES = ("creep", "dynamics")


class FitSettings:
    """Numbers of a fit."""

    steps: int = 12
    calm: int = 2
    """Of a fit
    from each start (Smith 1999)."""
    method: str = "newton"

    rate_hz: float = 5.0
    least: float = 0.1
    """At which it is read, and what counts. Set on 3 drawn stages."""
'''


def test_page_in_the_docs_is_that_of_the_sources():
    assert constants_table.main(["--check"]) == 0


def test_numbers_of_modules_and_settings_are_listed_with_unit_and_source():
    meaning, source = "How long it lasts, and by how much.", "Set on 40 drawn stages."
    assert list(map(tuple, constants_table.constants(MODULE))) == [
        ("LONGEST_S", "`2.5`", "s", meaning, source),
        ("FACTOR", "`-3`", "1", meaning, source),
        ("FitSettings.steps", "`12`", "1", "", "Of a fit from each start (Smith 1999)."),
        ("FitSettings.calm", "`2`", "1", "", "Of a fit from each start (Smith 1999)."),
        ("FitSettings.rate_hz", "`5.0`", "Hz", "At which it is read, and what counts.",
         "Set on 3 drawn stages."),
        ("FitSettings.least", "`0.1`", "1", "At which it is read, and what counts.",
         "Set on 3 drawn stages.")]
