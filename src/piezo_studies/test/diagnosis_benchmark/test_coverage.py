# SPDX-License-Identifier: BSD-3-Clause
"""Coverage of intervals whose errors are known, and the section that tells of it."""

import numpy as np
import pytest

from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_studies.diagnosis_benchmark.calibration_section import write_section
from piezo_studies.diagnosis_benchmark.coverage import coverage, estimates


def test_intervals_contain_the_parameter_as_often_as_their_level_says():
    errors = np.random.default_rng(2).normal(size=4000)
    results = [{"estimates": [{"true": 0.0, "found": error, "standard_deviation": 1.0}]}
               for error in errors]
    found = coverage([*results, {"verdict": "refused"}])
    assert found["intervals"] == 4000
    assert found["right"] / 4000 == pytest.approx(found["level"], abs=0.015)


def test_a_play_is_as_wide_as_both_its_halves():
    entry = {"name": "backlash", "parameters": {"width_um": 1.02},
             "standard_deviations": {"width_um": 0.02}}
    estimate, = estimates("backlash", SoftBacklash(0.5), [{"name": "delay"}, entry])
    assert (estimate["true"], estimate["found"]) == (1.0, 1.02)
    estimate, = estimates("backlash", SoftBacklash(0.5), [entry], {"width_um": 0.9})
    assert (estimate["true"], estimate["drawn"]) == (0.9, 1.0)
    assert coverage([{"estimates": [estimate]}])["right"] == 0
    assert coverage([{"estimates": [estimate]}], "drawn")["right"] == 1
    assert estimates("backlash", SoftBacklash(0.5), [{"name": "delay"}]) == []


def document():
    return {
        "seed": 7, "all_along": True, "results": [{}, {}, {}],
        "outcomes": {"clear": {"right": 2, "wrong": 1}},
        "coverage": {"level": 0.9, "intervals": 4, "right": 3},
        "calibration": {"expected_calibration_error": 0.125,
                        "of_a_calibrated_program": {"mean": 0.061, "most": 0.142}, "bins": [
            {"from": 0.8, "to": 0.9, "stated": None, "true": None, "cases": 0},
            {"from": 0.9, "to": 1.0, "stated": 0.95, "true": 2 / 3, "cases": 3}]}}


def test_the_section_is_written_anew_and_the_page_stays(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("above\n<!-- calibration -->\nold\n<!-- end -->\nbelow\n")
    write_section(page, document())
    text = page.read_text()
    assert text.startswith("above\n") and text.endswith("<!-- end -->\nbelow\n")
    assert "old" not in text
    assert "| 0.9 to 1.0 | 3 | 0.95 | 0.67 |" in text and "3 of 4" in text
    assert "| 0.061 |" in text and "| 0.142 |" in text


def test_a_page_without_the_section_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    with pytest.raises(ValueError, match="has the sections none"):
        write_section(page, document())
