# SPDX-License-Identifier: BSD-3-Clause
"""What is told of the delay of rows, where it is known and where the rows cannot tell it."""

import numpy as np
import pytest

from piezo_identification.conditioning.row_alignment import RowDelay, remaining_delay
from piezo_identification.estimators.estimate import DelayEstimate
from piezo_identification.identification.row_delays import report_row_delays

PERIOD_S = 0.5


def told(row):
    texts = []
    report_row_delays({"hysteresis": row}, texts.append)
    return texts[0]


@pytest.mark.parametrize(("noise_um", "words"), [
    (0.01, "a delay of 0.167 +-"), (5.0, "no significant delay"), (50.0, "not identifiable")])
def test_a_delay_of_a_third_of_a_row_is_told_as_far_as_the_noise_lets_it(noise_um, words):
    """Slow loops, fifty rows each, of 10 um."""
    time_s = np.arange(200) * PERIOD_S
    simulated_um, measured_um = (
        10.0 * np.sin(2.0 * np.pi * (time_s - delay_s) / (50 * PERIOD_S))
        for delay_s in (0.0, PERIOD_S / 3.0))
    measured_um = measured_um + noise_um * np.random.default_rng(2).normal(size=time_s.size)
    row = RowDelay(0.0, *remaining_delay(
        measured_um, simulated_um, PERIOD_S, np.ones((time_s.size, 1))), PERIOD_S)
    assert words in told(row)
    assert row.is_significant == ("a delay of" in words)


def test_a_delay_of_several_rows_with_a_deviation_as_large_is_not_reported():
    text = told(RowDelay(0.0, 3.2, 2.9, PERIOD_S))
    assert text.endswith("a remaining delay is not identifiable from these rows")
    assert "3.2" not in text
    # That it differs from none by many deviations does not make rows tell it.
    assert not RowDelay(0.0, 5.0, 0.4, PERIOD_S).is_significant
    assert not RowDelay(0.0, 0.0, np.inf, PERIOD_S).is_identifiable


def test_a_delay_that_rows_do_not_tell_is_neither_printed_nor_kept():
    """Noise in the place of a response: its fit gives a delay of seven rows, and nothing of it."""
    row = RowDelay(0.0, -182e-6, 0.7, 25e-6)
    assert row.fields() == {"read_at_samples": 0.0, "standard_deviation_s": 0.7}
    assert row.fields().keys() | {"delay_s"} == RowDelay(0.0, 2e-6, 1e-7, 25e-6).fields().keys()
    text = str(DelayEstimate(-182e-6, 0.7, 25e-6))
    assert text == "not identifiable from these rows, left out"
    # Ten rows that are told to one are a delay all the same.
    assert str(DelayEstimate(2.5e-4, 2.5e-5, 25e-6)).endswith(", significant")
    assert "0.2 +- 1 us" in str(DelayEstimate(2e-7, 1e-6, 25e-6))
