# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_studies.high_bandwidth.trade_off import (
    LIGHT_MODE_ERRORS,
    TITLES,
    Compared,
    draw,
    searched_table,
    sections,
)


def design(worst_peak_sensitivity, noise_voltage_v=3.0):
    figures = {"worst_peak_sensitivity": worst_peak_sensitivity, "bandwidth_hz": 750.0,
               "worst_bandwidth_hz": 607.0, "attenuation_db": (33.1, 21.2),
               "worst_attenuation_db": (31.9, 19.8)}
    report = {"figures": figures, "margin_db": 1.25, "added_noise_um": 0.0036, "order": 7,
              "noise_voltage_v": noise_voltage_v,
              "demands": {"added_noise_um": 0.009, "noise_voltage_v": 3.3,
                          "worst_peak_sensitivity": 4.0}}
    one = np.ones((1, 1))
    return FeedbackController(one, one, one, one, 25e-6, report, {})


@pytest.fixture
def compared():
    rows = {"h_infinity": design(3.99), "notch_pi": design(4.6),
            "integral_resonant": design(3.9, 5.0)}
    return [Compared(method, error, every_stage, rows.get(method))
            for every_stage in (False, True) for error in LIGHT_MODE_ERRORS for method in TITLES]


def test_what_exceeds_a_bound_stands_in_brackets(compared):
    text = sections(compared)["designs: the model itself"]
    assert ("| H-infinity | 5 % | 3.99 | +1.2 dB | 750 Hz | 607 Hz | 33.1 dB | 31.9 dB | "
            "21.2 dB | 19.8 dB | 3.6 nm | 3.00 V | 7 |") in text
    assert "| notch + PI | (5 %) | (4.60) |" in text
    assert "(5.00 V)" in text
    assert "| not stable |" in text


def test_what_searches_found_is_told_beside_their_seeds():
    found = {"seed": 3, "starts": 4, "trials": 60, "margin_db": -4.89,
             "demands": {"errors": {"light_mode": 0.2}, "of_every_stage": True}}
    assert searched_table([found]).endswith(
        "| 20 % | every stage | 3 | 4, 60 | -4.9 dB |\n")


def test_the_picture_leaves_out_what_exceeds_a_bound(compared):
    axes, = draw(compared).axes
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    np.testing.assert_array_equal(drawn["H-infinity"], [1.25] * len(LIGHT_MODE_ERRORS))
    assert np.isnan(drawn["notch + PI"]).all()
