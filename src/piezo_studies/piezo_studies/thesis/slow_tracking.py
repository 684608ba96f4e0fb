# SPDX-License-Identifier: BSD-3-Clause
"""Sections 2.4.2 and 2.4.3: 40 um at 1 Hz and 25 Hz by feedforward, PID and both.

The PID runs at the sample rate, as in the thesis. The composite control has the H-infinity feedback
of the multirate scheme.
"""

import numpy as np

from piezo_common.picture_style import MODE_STYLES, PID, label, new_figure
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.tracked_stage import FAST, PRINTED_PID, controller, track

AMPLITUDE_UM = 40.0
SECTIONS = ((1.0, "2.4.2", 1.0), (25.0, "2.4.3", 0.4))
"""Frequency (Hz), section, and duration of tracking (s)."""

COLUMNS = (("open loop", "open_loop", 40, None), ("feedforward", "feedforward", 40, None),
           ("PID at 40 kHz", "pid", FAST, None),
           ("PID (2.31) as printed", "pid", FAST, PRINTED_PID),
           ("composite", "composite", 40, None))
"""Name, mode, samples per tick and method of the feedback."""

THESIS_PERCENT = {"feedforward": (6.08, None), "PID (2.31) as printed": (0.15, 3.0),
                  "composite": (0.035, 0.31)}


def study():
    """Compute the PID and the tracking errors."""
    report = controller("pid", FAST).report
    rows = [
        Row("2.4.2", "ultimate gain by relay", 2.62, report["ultimate_gain_v_per_um"], "V/um",
            "by a relay over the whole range; a small swing shows a larger gain than a large "
            "one allows"),
        Row("2.4.2", "ultimate period by relay", 0.002, report["ultimate_period_s"], "s"),
    ]
    figure = new_figure(3.2)
    axes = figure.subplots(1, len(SECTIONS))
    for column, (place, (frequency_hz, section, duration_s)) in enumerate(
            zip(axes, SECTIONS, strict=True)):
        for name, mode, samples_per_tick, method in COLUMNS:
            tracked = track(mode, frequency_hz, AMPLITUDE_UM, samples_per_tick, duration_s, method)
            thesis = THESIS_PERCENT[name][column] if name in THESIS_PERCENT else None
            rows.append(Row(section, f"e_rms at {frequency_hz:g} Hz, {name}", thesis,
                            tracked.e_rms_percent, "%", tracked.remark))
            if name in ("PID at 40 kHz", "composite"):
                period = round(40_000 / frequency_hz)
                time_ms = 1e3 * np.arange(period) / 40_000
                place.plot(time_ms, tracked.error_um[-period:],
                           **(PID if mode == "pid" else MODE_STYLES[mode]))
        label(place, "time (ms)", "error (um)", f"{frequency_hz:g} Hz")
    axes[0].legend()
    return Study(rows, {"2.11": figure})
