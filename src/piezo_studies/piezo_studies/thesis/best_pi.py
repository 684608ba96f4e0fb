# SPDX-License-Identifier: BSD-3-Clause
"""The smallest error that any PI controller can attain on the stage."""

from functools import cache
from itertools import product

import control
import numpy as np

from piezo_controller.feedback.loop_measures import is_stable
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_studies.thesis.identified_stage import identified_stage

CLOCK_PERIOD_S = 25e-6
PEAK_SENSITIVITY = 3.0
"""Largest peak sensitivity; it is generous, as the phase margin may be only 19 degrees."""

PROPORTIONAL_V_PER_UM = np.linspace(0.0, 1.5, 31)
INTEGRAL_V_PER_UM_S = np.geomspace(100.0, 3000.0, 60)
BAND_HZ = np.geomspace(1.0, 19e3, 1500)
SINE_PERCENT = 100.0 / (2.0 * np.sqrt(2.0))
"""RMS of a sine over its peak-to-peak value, in percent."""


@cache
def best_error_percent(frequency_hz):
    """Return the smallest e_rms of a sine with any PI controller at the sample rate.

    It is predicted by the identified model, without offset and noise.

    Returns
    -------
    float
        Error e_rms (2.32) in percent.
    """
    plant, gain_um_per_v = design_plant(identified_stage(), CLOCK_PERIOD_S, CLOCK_PERIOD_S)
    plant = gain_um_per_v * plant
    points = np.exp(2j * np.pi * np.r_[frequency_hz, BAND_HZ] * CLOCK_PERIOD_S)
    response = plant(points, squeeze=True)
    least = np.inf
    for proportional, integral in product(PROPORTIONAL_V_PER_UM, INTEGRAL_V_PER_UM_S):
        answer = proportional + integral * CLOCK_PERIOD_S / (points - 1.0)
        size = 1.0 / np.abs(1.0 + response * answer)
        if size[0] < least and size.max() <= PEAK_SENSITIVITY and is_stable(
                control.feedback(plant * _feedback(proportional, integral), 1)):
            least = size[0]
    return float(SINE_PERCENT * least)


def _feedback(proportional, integral):
    return control.ss([[1.0]], [[CLOCK_PERIOD_S]], [[integral]], [[proportional]], CLOCK_PERIOD_S)
