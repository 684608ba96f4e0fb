# SPDX-License-Identifier: BSD-3-Clause
"""Sections 5.3.2 and 5.3.3: 21 um at 500 Hz and 10.25 um at 1 kHz, multirate and single rate."""

from itertools import product

import numpy as np
from scipy.signal import periodogram

from piezo_common.picture_style import FEEDBACK, FEEDFORWARD, LIMIT, MODE_STYLES, label, new_figure
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.stage_design import answer_times_s
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.tracked_stage import FAST, OFFSET_UM, controller, track

CLOCK_HZ = 40_000.0
SINES = ((500.0, 21.0, 2.3), (1000.0, 10.25, 2.2))
"""Frequency (Hz), peak-to-peak amplitude (um), e_rms of the thesis (%)."""

COLUMNS = (("open loop", "open_loop", 40), ("PID at 40 kHz", "pid", FAST),
           ("feedforward", "feedforward", 40), ("composite", "composite", 40))
SINGLE_RATE_LOSS = {500.0: 1.68, 1000.0: 1.46}
"""Factor by which the errors of the thesis grow with a single rate and a reduced order (5.3.3)."""

INVERSE_SINES = (40.0, 80.0), (100.0, 40.0), (500.0, 21.0), (1000.0, 10.25)
SLOW_SINGLE_RATE_HZ = 250.0
JUMP_S = 0.1
SETTLED = 0.05
TICK = 40
HIGHEST_FEEDBACK_HZ = 200.0


def study():
    """Compute errors, transients and spectra, and the errors with one rate for both branches."""
    rows, transients, spectra = [], new_figure(3.0), new_figure(3.0)
    for place, spectrum, (frequency_hz, amplitude_um, thesis) in zip(
            transients.subplots(1, 2), spectra.subplots(1, 2), SINES, strict=True):
        sine = f"{frequency_hz:g} Hz"
        for name, mode, samples_per_tick in COLUMNS:
            tracked = track(mode, frequency_hz, amplitude_um, samples_per_tick)
            rows.append(Row("5.3.2", f"e_rms at {sine}, {name}",
                            thesis if mode == "composite" else None, tracked.e_rms_percent, "%",
                            tracked.remark))
        jumped = track("composite", frequency_hz, amplitude_um, jump_s=JUMP_S)
        rows.append(Row("5.3.2", f"settling at {sine} after an offset", 0.020,
                        settling_s(jumped.error_um), "s",
                        f"to 5 % of {OFFSET_UM:g} um, of the mean over a tick; Fig. 5.6"))
        draw_transient(place, jumped.error_um, sine)
        rows.append(Row("5.3.2", f"power of the feedback below 200 Hz, {sine}", None,
                        draw_spectra(spectrum, track("composite", frequency_hz, amplitude_um),
                                     sine), "%", "all of it in Fig. 5.9"))
        fast = track("composite_single_rate", frequency_hz, amplitude_um, FAST)
        rows.append(Row("5.3.3", f"e_rms at {sine}, one rate of 40 kHz",
                        thesis * SINGLE_RATE_LOSS[frequency_hz], fast.e_rms_percent, "%",
                        f"thesis: at order 10, its board overruns at 15; {fast.remark}"))
    slow, multi = (track(mode, SLOW_SINGLE_RATE_HZ, SINES[0][1])
                   for mode in ("composite_single_rate", "composite"))
    rows += [
        Row("5.3.3", "e_rms at 250 Hz, one rate of 1 kHz", None, slow.e_rms_percent, "%",
            "from 500 Hz on, this rate cannot represent the reference (Nyquist)"),
        Row("5.3.3", "e_rms at 250 Hz, multirate", None, multi.e_rms_percent, "%"),
        *_computing_rows(), *_inverse_rows(),
    ]
    return Study(rows, {"5.6": transients, "5.9": spectra})


def settling_s(error_um):
    """Return the time after the jump until the tick means stay within 5 % of the offset."""
    mean_um = error_um[: error_um.size // TICK * TICK].reshape(-1, TICK).mean(axis=1)
    jump = round(JUMP_S * CLOCK_HZ / TICK)
    outside = np.flatnonzero(np.abs(mean_um[jump:] - mean_um[-TICK:].mean()) > SETTLED * OFFSET_UM)
    return (outside[-1] + 1) * TICK / CLOCK_HZ


def draw_transient(axes, error_um, title):
    """Draw the error about the jump."""
    shown = slice(round((JUMP_S - 0.01) * CLOCK_HZ), round((JUMP_S + 0.04) * CLOCK_HZ))
    time_ms = 1e3 * (np.arange(error_um.size) / CLOCK_HZ - JUMP_S)
    axes.plot(time_ms[shown], error_um[shown], **MODE_STYLES["composite"])
    label(axes, "time after the offset (ms)", "error (um)", title)


def draw_spectra(axes, tracked, title):
    """Draw spectra of feedforward and feedback; return the feedback's power below 200 Hz (%)."""
    count = tracked.error_um.size
    feedback_v = tracked.played.feedback_v[-count:]
    for voltage_v, style in (
            (tracked.played.voltage_v[-count:] - feedback_v, FEEDFORWARD), (feedback_v, FEEDBACK)):
        frequency_hz, power = periodogram(voltage_v, CLOCK_HZ, "hann")
        shown = (frequency_hz > 0) & (frequency_hz < 2500.0)
        axes.semilogy(frequency_hz[shown], power[shown], **style)
    axes.axvline(HIGHEST_FEEDBACK_HZ, **LIMIT)
    axes.set_ylim(1e-12, None)
    axes.legend(fontsize="x-small")
    label(axes, "frequency (Hz)", "power (V²/Hz)", title)
    below = frequency_hz < HIGHEST_FEEDBACK_HZ
    return 100.0 * power[below].sum() / power.sum()


def _computing_rows():
    """Measure the computing time of a tick at both rates."""
    rows = []
    for name, samples_per_tick in (("multirate", 40), ("one rate of 40 kHz", FAST)):
        found = controller("h_infinity", samples_per_tick)
        tick_us = 1e6 * samples_per_tick / CLOCK_HZ
        taken_us = 1e6 * np.percentile(
            answer_times_s(MultirateFeedback(found), samples_per_tick), 99.0)
        rows.append(Row("5.3.3", f"computing time of a tick, {name}", None, taken_us, "us",
                        "99th percentile on the machine that wrote this, which was not idle; "
                        f"order {found.report['order']}; a tick is {tick_us:g} us"))
    return rows


def _inverse_rows():
    """Compare feedback before and after the inverse hysteresis, by the node and by the stage."""
    rows = []
    for (frequency_hz, amplitude_um), (loop, onboard), (name, before_inverse) in product(
            INVERSE_SINES, (("answered", False), ("on board", True)),
            (("behind", False), ("before", True))):
        tracked = track("composite", frequency_hz, amplitude_um, before_inverse=before_inverse,
                        onboard=onboard)
        rows.append(Row(
            "5.3.2", f"e_rms at {frequency_hz:g} Hz, {amplitude_um:g} um, feedback {loop}, {name} "
            "the inverse", None, tracked.e_rms_percent, "%", tracked.remark))
    return rows
