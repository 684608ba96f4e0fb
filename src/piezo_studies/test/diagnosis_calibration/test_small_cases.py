# SPDX-License-Identifier: BSD-3-Clause
"""Small cases: what is drawn, that a run goes on, and what the page says of known statements."""

import json
from collections import Counter

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_studies.diagnosis_benchmark.effect_draws import CAUSES_OUTSIDE
from piezo_studies.diagnosis_calibration import study
from piezo_studies.diagnosis_calibration.model_errors import sentence
from piezo_studies.diagnosis_calibration.page import SECTION, write_page
from piezo_studies.diagnosis_calibration.small_cases import KINDS, LEVELS, draw_case, waveform


def test_causes_none_and_those_outside_the_list_are_drawn_in_their_shares():
    cases = [draw_case(number, 7) for number in range(2000)]
    none = np.mean([case.cause is None for case in cases])
    outside = np.mean([case.cause in CAUSES_OUTSIDE for case in cases])
    assert (none, outside) == pytest.approx((0.15, 0.1), abs=0.03)
    assert set(Counter(case.kind for case in cases)) == set(KINDS)
    sizes = np.log([case.multiple for case in cases])
    assert np.quantile(sizes, 0.5) == pytest.approx(np.log(np.sqrt(0.3 * 40.0)), abs=0.2)
    assert cases[5] == draw_case(5, 7) != draw_case(5, 8)


def test_waveforms_stay_within_the_voltages_of_the_stage():
    kinds = Counter()
    for number in range(60):
        case = draw_case(number, 7)
        voltage_v = waveform(case).voltage_v
        kinds[case.kind] += 1
        assert 5.0 <= voltage_v.min() < voltage_v.max() <= 95.0
        assert np.ptp(voltage_v) > 15.0
        assert np.abs(np.diff(voltage_v)).max() < 8.0 * LEVELS * 70.0 / voltage_v.size + 40.0
    assert set(kinds) == set(KINDS)


def told(number, share, *causes, label="delay"):
    return {
        "number": number, "model": "identified before", "verdict": "explained", "in_model": [],
        "contributions": [{"cause": cause, "over_noise": 9.0} for cause in causes],
        "effects": [label], "not_decidable": [],
        "probabilities": {label: share, "something_else": 1.0 - share},
        "estimates": [{"cause": cause, "name": "delay_s", "drawn": 9.0, "true": 1.0,
                       "found": 1.0 + number, "standard_deviation": 2.0}
                      for cause in causes if cause == label]}


def test_a_run_goes_on_from_the_results_that_are_kept(tmp_path, monkeypatch):
    asked = []

    def run_small_case(case, identified):
        asked.append(case.number)
        return None if case.number == 2 else told(case.number, 0.9, "delay")

    monkeypatch.setattr(study, "run_small_case", run_small_case)
    line = IdentifiedModel(StageModel(
        PreisachModel(0.0, 1.0, np.zeros((1, 1)), 0.0, np.ones(1)), CreepDynamics(),
        ElectricVibrationDynamics()), (0.0, 1.0))
    monkeypatch.setattr(study, "clean_model", lambda seed, plant: (line, None))
    study.run_study(5, 3, tmp_path, np.inf, lambda done: None)
    results = study.run_study(5, 5, tmp_path, np.inf, lambda done: None)
    assert asked == [0, 1, 2, 3, 4]
    assert [result["number"] for result in results] == [0, 1, 3, 4]
    lines = (tmp_path / "cases_5.jsonl").read_text().splitlines()
    assert [json.loads(line)["of"] for line in lines] == asked


def test_the_page_tells_what_came_true(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n<!-- {SECTION} -->\nold\n<!-- end -->\nbehind\n")
    # Of four statements of 0.9 two are true, and both intervals contain the parameter.
    results = [told(number, 0.9, "delay" if number < 2 else "creep") for number in range(4)]
    write_page(page, 5, results)
    text = page.read_text()
    assert "4 cases of seed 5:" in text and "old" not in text
    assert "| 0.9 to 1.0 | 4 | 0.90 | 0.50 |" in text
    assert "| expected calibration error | 0.400 |" in text
    assert "| 90 % intervals of `delay` | 2 of 2 |" in text
    assert "| the same, where it is explained | 2 of 2 |" in text
    assert "| the same, of the parameter that was drawn | 0 of 2 |" in text
    assert text.startswith("before\n") and text.endswith("behind\n")
    assert (tmp_path / "pictures" / "diagnosis_calibration.png").stat().st_size > 1000


def test_errors_of_models_are_told_over_what_their_files_state():
    assert sentence(np.array([0.5, 1.0, 3.0])) == (
        "in 3 recordings the models are wrong by 1.00 times what their files state (median; "
        "10 % below 0.60, 10 % above 2.60, at most 3.00)")
