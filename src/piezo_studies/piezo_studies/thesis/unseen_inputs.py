# SPDX-License-Identifier: BSD-3-Clause
"""Section 4.7.2: the identified model of the stage for unseen inputs."""

import numpy as np

from piezo_common.picture_style import MEASURED, MODELLED, label, new_figure
from piezo_identification.prediction import predict
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.identified_stage import identified_stage
from piezo_studies.thesis.laboratory import CLOCK_HZ, STAGE_NOISE_UM, record_stage

HIGHEST_V = 50.0
SLOW_CLOCK_HZ = 1000.0
SETTLING_S = 0.1
TRIANGLE_HZ = 100.0
TRIANGLE_EXTREMES_V = (50.0, 35.0, 20.0)
SECTION = "4.7.2"


def sine_v(frequency_hz, clock_hz, duration_s):
    """Return the sine between 0 and 50 V."""
    time_s = np.arange(round(duration_s * clock_hz)) / clock_hz
    return 0.5 * HIGHEST_V * (1.0 - np.cos(2.0 * np.pi * frequency_hz * time_s))


def multi_frequency_v(duration_s):
    """Return the input of Fig. 4.12 (e)."""
    time_s = np.arange(round(duration_s * CLOCK_HZ)) / CLOCK_HZ
    phase = 2.0 * np.pi * time_s
    return 11.0 + (2.0 * np.sin(100.0 * phase) + np.sin(300.0 * phase)
                   + np.sin(400.0 * phase) + np.sin(500.0 * phase))


def falling_triangle_v(duration_s):
    """Return repeated triangles of falling amplitude."""
    half = round(0.5 * CLOCK_HZ / TRIANGLE_HZ)
    ramp = np.arange(half) / half
    period_v = np.concatenate([
        part for extreme_v in TRIANGLE_EXTREMES_V for part in (extreme_v * ramp,
                                                              extreme_v * (1.0 - ramp))
    ])
    return np.resize(period_v, round(duration_s * CLOCK_HZ))


def inputs():
    """Return name, figure of the thesis (%), voltages (V) and clock (Hz) of each input."""
    return (
        ("0.05 Hz", 0.51, sine_v(0.05, SLOW_CLOCK_HZ, 40.0), SLOW_CLOCK_HZ),
        ("4 Hz", 1.08, sine_v(4.0, CLOCK_HZ, 1.0), CLOCK_HZ),
        ("250 Hz", 1.79, sine_v(250.0, CLOCK_HZ, 0.5), CLOCK_HZ),
        ("600 Hz", 2.42, sine_v(600.0, CLOCK_HZ, 0.5), CLOCK_HZ),
        ("multi-frequency", 1.42, multi_frequency_v(0.5), CLOCK_HZ),
        ("multi-amplitude", 2.46, falling_triangle_v(0.5), CLOCK_HZ),
    )


def study():
    """Compute the relative errors e_y of Table 4.1, by the sensor."""
    model = identified_stage()
    rows, loops = [], {}
    for seed, (name, thesis, voltage_v, clock_hz) in enumerate(inputs(), start=11):
        # The multi-frequency input does not begin at 0 V.
        before_v = np.linspace(0.0, voltage_v[0], round(SETTLING_S * clock_hz))
        prediction = predict(
            model, record_stage(name, voltage_v, before_v, clock_hz=clock_hz, seed=seed)
        )
        settled = prediction.time_s > SETTLING_S
        measured_um = prediction.measured_um[settled]
        floor = 100.0 * STAGE_NOISE_UM / np.std(measured_um)
        rows.append(Row(
            SECTION, f"e_y, {name}" + (" (100 Hz in the text)" if name == "250 Hz" else ""),
            thesis, prediction.e_y_percent(settled), "%",
            f"noise of the sensor alone: {floor:.2g} %"
            + ("; 5 V move this stage only a little" if name == "multi-frequency" else ""),
        ))
        loops[name] = (prediction.voltage_v[settled], measured_um, prediction.simulated_um[settled])
    return Study(rows, {"4.12": _draw(loops)})


def _draw(loops):
    figure = new_figure(3.6)
    axes = figure.subplots(2, 3)
    for place, (name, (voltage_v, measured_um, simulated_um)) in zip(
        axes.flat, loops.items(), strict=True
    ):
        # Draw only the end of the record, thinned.
        part = slice(-20_000, None, 20) if name in ("0.05 Hz", "4 Hz") else slice(-1200, None)
        place.plot(voltage_v[part], measured_um[part], **MEASURED)
        place.plot(voltage_v[part], simulated_um[part], **MODELLED)
        label(place, title=name)
    axes[0, 0].legend(fontsize="x-small")
    figure.supxlabel("voltage (V)", size="medium")
    figure.supylabel("displacement (um)", size="medium")
    return figure
