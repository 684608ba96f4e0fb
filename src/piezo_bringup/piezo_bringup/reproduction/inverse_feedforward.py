# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 4.14: sines under the inverse of the identified model, and under a gain alone."""

import numpy as np

from piezo_bringup.picture_style import MODE_STYLES, REFERENCE, label, new_figure
from piezo_bringup.reproduction.identified_stage import identified_stage
from piezo_bringup.reproduction.laboratory import CLOCK_HZ, record_stage
from piezo_bringup.reproduction.table import Study
from piezo_controller.feedforward import plan_feedforward
from piezo_controller.references import Reference, sample_reference

SLOW_CLOCK_HZ = 1000.0
CENTRE_UM = 45.0
SINES = ((0.05, 40.0, SLOW_CLOCK_HZ), (4.0, 40.0, CLOCK_HZ), (250.0, 40.0, CLOCK_HZ),
         (600.0, 20.0, CLOCK_HZ))
"""Frequency (Hz), peak-to-peak amplitude (um) and clock (Hz)."""


def study():
    """Displacement under both, drawn; the errors of Table 4.1 are not part of this study.

    Returns
    -------
    Study
    """
    figure = new_figure(3.8)
    axes = figure.subplots(2, 2)
    for place, (frequency_hz, amplitude_um, clock_hz) in zip(axes.flat, SINES, strict=True):
        reference_um = sample_reference(
            Reference("harmonic", (frequency_hz,), (amplitude_um,), centre_um=CENTRE_UM), clock_hz
        )
        time_s = np.arange(reference_um.size) / clock_hz
        time, unit = (time_s, "s") if frequency_hz < 1.0 else (1e3 * time_s, "ms")
        place.plot(time, reference_um, **REFERENCE)
        for mode in ("open_loop", "feedforward"):
            place.plot(time, last_period_um(reference_um, mode, clock_hz), **MODE_STYLES[mode])
        label(place, f"time ({unit})", "displacement (um)", f"{frequency_hz:g} Hz")
    axes[0, 0].legend(fontsize="x-small")
    return Study([], {"4.14": figure})


def last_period_um(reference_um, mode, clock_hz):
    """Displacement in the last period of a run, about the mean of the reference."""
    periods = max(2, round(0.5 * clock_hz / reference_um.size))
    plan = plan_feedforward(
        reference_um, identified_stage(), mode, sample_period_s=1.0 / clock_hz,
        duration_s=periods * reference_um.size / clock_hz,
    )
    count = plan.once_voltage_v.size + periods * reference_um.size
    record = record_stage(mode, plan.voltage_v(0, count), clock_hz=clock_hz)
    displacement_um = record.displacement_um[-reference_um.size :]
    return displacement_um - displacement_um.mean() + reference_um.mean()
