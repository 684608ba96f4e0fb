# SPDX-License-Identifier: BSD-3-Clause
"""Short cases: what is drawn, their waveforms, and the errors of models without effects."""

from collections import Counter

import numpy as np
import pytest

from piezo_studies.diagnosis_benchmark.effect_draws import CAUSES_OUTSIDE
from piezo_studies.diagnosis_benchmark.model_errors import sentence
from piezo_studies.diagnosis_benchmark.short_case import KINDS, LEVELS, draw_short_cases, waveform


def test_causes_none_and_those_outside_the_list_are_drawn_in_their_shares():
    cases = draw_short_cases(2000, 7)
    none = np.mean([not case.causes for case in cases])
    outside = np.mean([bool(CAUSES_OUTSIDE.keys() & set(case.causes)) for case in cases])
    assert (none, outside) == pytest.approx((0.15, 0.1), abs=0.03)
    assert set(Counter(case.kind for case in cases)) == set(KINDS)
    sizes = np.log([multiple for case in cases for multiple in case.multiples])
    assert np.quantile(sizes, 0.5) == pytest.approx(np.log(np.sqrt(0.3 * 40.0)), abs=0.2)
    assert cases[:9] == draw_short_cases(9, 7) != draw_short_cases(9, 8)


def test_waveforms_stay_within_the_voltages_of_the_stage():
    kinds = Counter()
    for case in draw_short_cases(60, 7):
        voltage_v = waveform(case).voltage_v
        kinds[case.kind] += 1
        assert 5.0 <= voltage_v.min() < voltage_v.max() <= 95.0
        assert np.ptp(voltage_v) > 15.0
        assert np.abs(np.diff(voltage_v)).max() < 8.0 * LEVELS * 70.0 / voltage_v.size + 40.0
    assert set(kinds) == set(KINDS)


def test_errors_of_models_are_told_over_what_their_files_state():
    assert sentence(np.array([0.5, 1.0, 3.0])) == (
        "in 3 recordings the models are wrong by 1.00 times what their files state (median; "
        "10 % below 0.60, 10 % above 2.60, at most 3.00)")
