# SPDX-License-Identifier: BSD-3-Clause
"""Coverage of intervals whose errors are known, and the section that tells of it."""

import numpy as np
import pytest

from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_studies.diagnosis_benchmark.calibration_section import write_section
from piezo_studies.diagnosis_benchmark.coverage import coverage, estimates
from piezo_studies.diagnosis_benchmark.outcome import summary


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


def told(number, share, *causes, label="delay"):
    return {
        "number": number, "model": "identified before", "verdict": "explained", "in_model": [],
        "contributions": [{"cause": cause, "over_noise": 9.0} for cause in causes],
        "effects": [label], "not_decidable": [],
        "probabilities": {label: share, "something_else": 1.0 - share},
        "estimates": [{"cause": cause, "name": "delay_s", "drawn": 9.0, "true": 1.0,
                       "found": 1.0 + number, "standard_deviation": 2.0}
                      for cause in causes if cause == label]}


def test_the_page_tells_what_came_true(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- short cases -->\nold\n<!-- end -->\nbehind\n")
    # Of four statements of 0.9 two are true, and both intervals contain the parameter.
    results = [told(number, 0.9, "delay" if number < 2 else "creep") for number in range(4)]
    write_section(page, {"kind": "short", "seed": 5, "results": results,
                         **summary(results)})
    text = page.read_text()
    assert "4 short cases of seed 5:" in text and "old" not in text
    assert "| 0.9 to 1.0 | 4 | 0.90 | 0.50 |" in text
    assert "| expected calibration error | 0.400 |" in text
    assert "| 90 % intervals of `delay` | 2 of 2 |" in text
    assert "| the same, where it is explained | 2 of 2 |" in text
    assert "| the same, of the parameter that was drawn | 0 of 2 |" in text
    assert text.startswith("before\n") and text.endswith("behind\n")
    assert (tmp_path / "pictures" / "diagnosis_short.png").stat().st_size > 1000


def test_a_page_without_the_section_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    with pytest.raises(ValueError, match="has the sections none"):
        write_section(page, {"kind": "long", "seed": 7, "results": [told(1, 0.9)],
                             "outcomes": {}})
