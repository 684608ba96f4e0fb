# SPDX-License-Identifier: BSD-3-Clause
"""The calibration of probabilities that are known to be right, or known to be too sure."""

import matplotlib.figure
import numpy as np
import pytest

from piezo_studies.diagnosis_benchmark.reliability import (
    calibrate,
    draw_reliability,
    is_true,
    reliability,
)


def result(probabilities, *causes, over_noise=9.0, verdict="explained", in_model=()):
    return {
        "model": "identified before", "lacking_over_noise": over_noise, "verdict": verdict,
        "contributions": [
            {"cause": cause, "over_noise": over_noise, "beyond_model_over_noise": over_noise}
            for cause in causes],
        "effects": [], "not_decidable": [], "probabilities": probabilities,
        "in_model": list(in_model),
    }


def tempered(probabilities, temperature):
    """Return probabilities with their logarithms over a temperature, summing to one."""
    powers = {label: share ** (1.0 / temperature) for label, share in probabilities.items()}
    whole = sum(powers.values())
    return {label: power / whole for label, power in powers.items()}


def drawn(count, too_sure=1.0, seed=3):
    """Return cases whose probabilities are right before they are sharpened."""
    generator = np.random.default_rng(seed)
    cases = []
    for share in generator.uniform(0.05, 0.95, count):
        right = {"delay": float(share), "creep": float(1.0 - share)}
        cause = "delay" if generator.random() < share else "creep"
        cases.append(result(tempered(right, 1.0 / too_sure), cause))
    return cases


def test_probabilities_that_come_true_are_calibrated():
    found = calibrate(drawn(4000))
    assert found.expected_calibration_error < 0.03
    assert sum(found.counts) == 4000
    assert calibrate(drawn(4000, too_sure=4.0)).expected_calibration_error > 0.1


def test_the_error_is_the_mean_distance_by_the_counts():
    found = reliability(np.array([0.9, 0.9, 0.9, 0.3]), np.array([True, True, False, False]), 2)
    assert found.counts == (1, 3)
    assert found.expected_calibration_error == pytest.approx(
        0.25 * 0.3 + 0.75 * abs(0.9 - 2.0 / 3.0))


def test_few_cases_have_an_error_though_their_probabilities_are_right():
    probabilities = np.full(10, 0.7)
    found = reliability(probabilities, np.arange(10) < 7)
    # Of 10 cases the mean distance of the share that comes true from 0.7 is 0.112 (binomial).
    assert found.expected_calibration_error == pytest.approx(0.0, abs=1e-12)
    assert found.calibrated_mean == pytest.approx(0.112, abs=0.005)
    assert found.calibrated_most == pytest.approx(0.3, abs=0.01)
    assert reliability(np.full(1000, 0.7), np.arange(1000) < 700).calibrated_mean < 0.015
    assert "of a calibrated program 0.11" in found.sentence()


@pytest.mark.parametrize(("label", "case", "expected"), [
    ("none", result({}), True),
    ("none", result({}, "delay"), False),
    ("none", result({}, "delay", over_noise=2.0), True),
    ("none", result({}, "delay", in_model=["delay"]), True),
    ("something_else", result({}, "self_heating"), True),
    ("something_else", result({}, "delay"), False),
    ("delay", result({}, "delay", "creep"), True),
    ("creep+delay", result({}, "delay", "creep"), True),
    ("creep+delay", result({}, "delay"), False),
    ("creep", result({}, "self_heating"), False),
])
def test_which_statements_are_true(label, case, expected):
    assert is_true(case, label) is expected


def test_the_diagram_shows_every_bin_that_has_cases():
    figure = matplotlib.figure.Figure()
    axes = figure.add_subplot()
    found = calibrate(drawn(50))
    draw_reliability(axes, found)
    assert sorted(int(text.get_text()) for text in axes.texts) == sorted(filter(None, found.counts))


def test_something_else_is_true_of_a_cause_outside_the_list_or_in_another_form():
    named = result({"something_else": 1.0}, "delay", verdict="unexplained") | {"effects": ["delay"]}
    unnamed = result({"something_else": 1.0}, "delay", verdict="unexplained")
    outside = result({"something_else": 1.0}, "self_heating", verdict="unexplained")
    told = [is_true(each, "something_else") for each in (named, unnamed, outside)]
    assert told == [True, False, True]
    strict = [is_true(each, "something_else", strict=True) for each in (named, unnamed, outside)]
    assert strict == [False, False, True]


def test_nothing_is_true_where_too_little_is_there():
    assert [is_true(result({}, cause, over_noise=size), "none") for cause, size in (
        ("delay", 2.0), ("self_heating", 2.0), ("delay", 9.0), ("self_heating", 9.0))] == [
        True, True, False, False]
