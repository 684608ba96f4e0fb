# SPDX-License-Identifier: BSD-3-Clause
"""The tables of the recipe stand in its page, and its recordings hold what they say."""

from pathlib import Path

import numpy as np
import pytest

from piezo_studies.recording_recipe import __main__ as recording_recipe
from piezo_studies.recording_recipe.__main__ import TABLES, Trial, page

PAGE = Path(__file__).parents[4] / "docs" / "recipe.md"
MADE = {name: [Trial("7 levels", 14.0, 14000, 0.12345)] for name in TABLES}


def test_page_has_a_table_of_every_trial_and_its_text_stays():
    before = PAGE.read_text(encoding="utf-8")
    after = page(before, MADE)
    assert after.count("| 7 levels | 14 s | 14000 | 0.12 % |") == len(TABLES)
    for name, (varied, _, _) in TABLES.items():
        header = f"<!-- trials of {name} -->\n| {varied} | recorded for |"
        assert header in before, "run make recipe"

    def text_of(written):
        return [line for line in written.splitlines() if not line.startswith("|")]

    assert text_of(after) == text_of(before)


def test_page_without_a_section_is_refused():
    with pytest.raises(ValueError, match="give it one for each of trials of levels"):
        page("no table", MADE)


def test_means_of_a_slow_recording_follow_the_voltage():
    recording = recording_recipe.hysteresis_recording(3, 100.0)
    playing = recording.select(recording.playing)
    assert playing.sample_period_s == pytest.approx(0.01)
    assert (playing.voltage_v.min(), playing.voltage_v.max()) == pytest.approx((-20.0, 120.0))
    assert np.corrcoef(playing.voltage_v, playing.displacement_um)[0, 1] > 0.95
