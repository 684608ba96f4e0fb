# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.measures import e_r_percent, e_rms_percent, e_y_percent


def test_e_rms_is_over_the_peak_to_peak_of_the_reference():
    assert e_rms_percent([0.0, 10.0, 0.0, 10.0], [1.0, 9.0, 1.0, 9.0]) == pytest.approx(10.0)


def test_e_rms_counts_the_offset_unless_told_otherwise():
    reference = np.array([0.0, 10.0])
    assert e_rms_percent(reference, reference + 2) == pytest.approx(20.0)
    assert e_rms_percent(reference, reference + 2, remove_offset=True) == 0.0


@pytest.mark.parametrize("measure", [e_y_percent, e_r_percent])
def test_norm_ratios_leave_the_offset_out_unless_told_otherwise(measure):
    truth, estimate = np.array([2.0, 4.0]), np.array([2.0, 3.0])
    assert measure(truth, estimate) == pytest.approx(50.0)
    assert measure(truth, estimate, remove_offset=False) == pytest.approx(100 / np.sqrt(20))


@pytest.mark.parametrize("measure", [e_rms_percent, e_y_percent, e_r_percent])
def test_signals_that_cannot_be_compared_are_refused(measure):
    with pytest.raises(ValueError, match="one length"):
        measure([1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="one length"):
        measure([], [])
    with pytest.raises(ValueError, match="constant"):
        measure([1.0, 1.0], [1.0, 2.0])
