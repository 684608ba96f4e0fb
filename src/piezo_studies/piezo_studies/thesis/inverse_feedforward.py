# SPDX-License-Identifier: BSD-3-Clause
"""Table 4.1 and fig. 4.14: tracking with the inverse of the identified model, and with a gain."""

import numpy as np

from piezo_common.picture_style import MODE_STYLES, REFERENCE, label, new_figure
from piezo_controller.feedforward.approach import StageClock
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_models.measures import e_r_percent
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.identified_stage import identified_stage
from piezo_studies.thesis.laboratory import CLOCK_HZ, record_stage

SECTION = "4.7.2, Table 4.1"
SLOW_CLOCK_HZ = 1000.0
CENTRE_UM = 45.0
SINES = ((0.05, 40.0, SLOW_CLOCK_HZ, 0.77, 7.52), (4.0, 40.0, CLOCK_HZ, 1.34, 9.12),
         (250.0, 40.0, CLOCK_HZ, 2.41, 74.88), (600.0, 20.0, CLOCK_HZ, 4.32, 107.12))
"""Frequency (Hz), peak-to-peak amplitude (um), clock (Hz), and the thesis' e_r (%) with and without
the inverse."""

MULTI_FREQUENCY = Reference("multi_frequency", (100.0, 300.0, 400.0, 500.0),
                            (24.0, 12.0, 12.0, 12.0), centre_um=CENTRE_UM)
OPEN_LOOP_REMARK = "gain of the whole range; the thesis chooses one for each frequency"
FALLING_AMPLITUDES_UM = 40.0, 27.0, 13.0
FALLING_BANDWIDTH_HZ = 1000.0


def study():
    """Compute errors and displacement with and without the inverse."""
    rows: list[Row] = []
    figure = new_figure(3.8)
    axes = figure.subplots(2, 2)
    for place, (frequency_hz, amplitude_um, clock_hz, *thesis) in zip(
            axes.flat, SINES, strict=True):
        reference_um = sample_reference(
            Reference("harmonic", (frequency_hz,), (amplitude_um,), centre_um=CENTRE_UM), clock_hz
        )
        played_um = _compare(rows, f"{frequency_hz:g} Hz", reference_um, clock_hz, thesis)
        time_s = np.arange(reference_um.size) / clock_hz
        time, unit = (time_s, "s") if frequency_hz < 1.0 else (1e3 * time_s, "ms")
        place.plot(time, reference_um, **REFERENCE)
        for mode, displacement_um in played_um.items():
            place.plot(time, displacement_um, **MODE_STYLES[mode])
        label(place, f"time ({unit})", "displacement (um)", f"{frequency_hz:g} Hz")
    axes[0, 0].legend(fontsize="x-small")
    _compare(rows, "multi-frequency", sample_reference(MULTI_FREQUENCY), CLOCK_HZ, (2.18, 56.95))
    _compare(rows, "multi-amplitude", falling_triangle_um(), CLOCK_HZ, (3.01, 39.03))
    return Study(rows, {"4.14": figure})


def falling_triangle_um():
    """Return one period of three triangles at 100 Hz of falling amplitude, with smooth corners.

    The thesis does not state their amplitudes.
    """
    triangle = sample_reference(Reference("triangle", (100.0,), (1.0,)))
    period_um = np.concatenate([amplitude * triangle for amplitude in FALLING_AMPLITUDES_UM])
    content = np.fft.rfft(period_um)
    content[np.fft.rfftfreq(period_um.size, 1.0 / CLOCK_HZ) > FALLING_BANDWIDTH_HZ] = 0.0
    return CENTRE_UM + np.fft.irfft(content, period_um.size)


def _compare(rows, name, reference_um, clock_hz, thesis):
    """Play a reference in both modes, add the rows, and return the displacements by mode."""
    played_um = {mode: last_period_um(reference_um, mode, clock_hz)
                 for mode in ("open_loop", "feedforward")}
    for mode, quantity, theirs, remark in (
            ("feedforward", "inversion", thesis[0], ""),
            ("open_loop", "open loop", thesis[1], OPEN_LOOP_REMARK)):
        rows.append(Row(SECTION, f"e_r, {name}, {quantity}", theirs,
                        e_r_percent(reference_um, played_um[mode]), "%", remark))
    return played_um


def last_period_um(reference_um, mode, clock_hz):
    """Return the displacement in the last period of a run, about the mean of the reference."""
    periods = max(2, round(0.5 * clock_hz / reference_um.size))
    plan = plan_feedforward(
        reference_um, identified_stage(), mode, stage=StageClock(sample_rate_hz=clock_hz),
        duration_s=periods * reference_um.size / clock_hz,
    )
    count = plan.once_voltage_v.size + periods * reference_um.size
    record = record_stage(mode, plan.voltage_v(0, count), clock_hz=clock_hz)
    displacement_um = record.displacement_um[-reference_um.size :]
    return displacement_um - displacement_um.mean() + reference_um.mean()
