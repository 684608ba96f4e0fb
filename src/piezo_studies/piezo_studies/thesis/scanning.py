# SPDX-License-Identifier: BSD-3-Clause
"""Section 3.4.4, Tables 3.1 and 3.2: sines at 40, 100 and 600 Hz.

The PI of (3.20) runs at the sample rate; a further row shows the composite control with it. Near
the peak of the sensitivity, feedback makes the error larger than feedforward alone.
"""

from functools import cache
from itertools import product

import control
import numpy as np

from piezo_common.picture_style import MODE_STYLES, REFERENCE, label, new_figure
from piezo_controller.feedback.loop_measures import is_stable
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.identified_stage import identified_stage
from piezo_studies.thesis.tracked_stage import FAST, PRINTED_PI, controller, track

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
    """Return the smallest e_rms (2.32) of a sine with any PI controller at the sample rate.

    It is predicted by the identified model, without offset and noise.
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


SECTION = "3.4.4"
SINES = ((40.0, 40.0), (100.0, 40.0), (600.0, 20.0))
"""Frequency (Hz) and peak-to-peak amplitude (um)."""

COLUMNS = (("open loop", "open_loop", 40, None), ("PI at 40 kHz", "pi", FAST, None),
           ("PI (3.23) as printed", "pi", FAST, PRINTED_PI),
           ("feedforward", "feedforward", 40, None),
           ("composite, PI at 40 kHz", "composite", FAST, "pi"),
           ("composite", "composite", 40, None))
"""Name, mode, samples per tick and method of the feedback."""

THESIS_PERCENT = {
    "open loop": (12.9, 29.1, 74.8), "PI (3.23) as printed": (6.31, 15.6, 40.1),
    "composite, PI at 40 kHz": (0.75, 1.21, 1.76), "composite": (0.75, 1.21, 1.76)}
OPEN_LOOP = "the thesis sets the gain at each frequency; ours is that of the whole range"
BEST_PI = f"by the identified model, with a peak sensitivity of up to {PEAK_SENSITIVITY:g}"
THESIS_COMPARED_PERCENT = 1.76
FIRST_MODE_HZ = 453.5
"""Frequency of the first mode, to which Table 3.2 relates scanning frequencies."""


def study():
    """Track the sines of Tables 3.1 and 3.2."""
    report = controller("pi", FAST).report
    rows = [
        Row("3.4.3", "ultimate gain, corrected for the hysteresis", 1.65,
            report["ultimate_gain_v_per_um"], "V/um", "the thesis' plant gives 1.88"),
        Row("3.4.3", "ultimate period", 0.0018, report["ultimate_period_s"], "s"),
    ]
    figure = new_figure(3.0)
    axes = figure.subplots(1, len(SINES))
    for column, (place, (frequency_hz, amplitude_um)) in enumerate(zip(axes, SINES, strict=True)):
        for name, mode, samples_per_tick, method in COLUMNS:
            tracked = track(mode, frequency_hz, amplitude_um, samples_per_tick, method=method)
            remark = OPEN_LOOP if mode == "open_loop" else tracked.remark
            thesis = THESIS_PERCENT[name][column] if name in THESIS_PERCENT else None
            rows.append(Row(SECTION, f"Table 3.1: e_rms at {frequency_hz:g} Hz, {name}", thesis,
                            tracked.e_rms_percent, "%", remark))
            if method == PRINTED_PI:
                rows.append(Row(
                    SECTION,
                    f"Table 3.1: e_rms at {frequency_hz:g} Hz, best attainable with any PI",
                    thesis, best_error_percent(frequency_hz), "%", BEST_PI))
            if name in ("open loop", "composite"):
                period = slice(-round(40_000 / frequency_hz), None)
                reference_um = tracked.reference_um[period]
                place.plot(reference_um, reference_um - tracked.error_um[period],
                           **MODE_STYLES[mode])
        place.plot(reference_um, reference_um, zorder=0, **REFERENCE)
        label(place, "desired (um)", "displacement (um)", f"{frequency_hz:g} Hz")
    axes[0].legend(fontsize="x-small")
    best = track("composite", *SINES[-1])
    rows.append(Row("3.4.5", "Table 3.2: e_rms at 600 Hz, 1.3 times the first mode",
                    THESIS_COMPARED_PERCENT, best.e_rms_percent, "%",
                    f"the first mode is at {FIRST_MODE_HZ:g} Hz; others reach 5.28 % at 300 Hz and "
                    "10.25 % at 450 Hz, according to the thesis"))
    return Study(rows, {"3.10": figure})
