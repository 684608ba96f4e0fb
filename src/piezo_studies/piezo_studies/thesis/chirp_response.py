# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 4.10: dynamics from the frequency response of a chirp, biased by the hysteresis.

The voltage is a chirp of constant amplitude above 100 Hz, applied to the plant of section 4.6.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import chirp, csd, welch

from piezo_common.picture_style import MEASURED, MODELLED, ORANGE, label, new_figure, plain_numbers
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.known_plant import HIGHEST_V, NOISE_UM, known_plant
from piezo_studies.thesis.laboratory import record_model

CLOCK_HZ = 20_000.0
DURATION_S = 10.0
BAND_HZ = (100.0, 1000.0)
SEGMENT = 4096
SECTION = "4.6.2"


def study():
    """Compute gain and mode from the frequency response, and compare them with the true ones."""
    plant = known_plant()
    time_s = np.arange(round(DURATION_S * CLOCK_HZ)) / CLOCK_HZ
    swing_v = 0.5 * HIGHEST_V
    voltage_v = swing_v * (1.0 - chirp(time_s, BAND_HZ[0], DURATION_S, BAND_HZ[1]))
    record = record_model("chirp", plant, voltage_v, 1.0 / CLOCK_HZ, NOISE_UM)
    frequency_hz, by_voltage = _response(voltage_v, record.displacement_um)
    _, by_hysteresis = _response(plant.hysteresis.simulate(voltage_v), record.displacement_um)
    gain, ignored = fit_response(frequency_hz, by_voltage)
    _, known = fit_response(frequency_hz, by_hysteresis)
    small, large = (_first_gain(plant.hysteresis, part * HIGHEST_V) for part in (0.2, 1.0))
    true_rad_per_s = plant.dynamics.mode_frequencies_rad_per_s[0]

    def shift_percent(dynamics):
        return float(100.0 * (dynamics.mode_frequencies_rad_per_s[0] / true_rad_per_s - 1.0))

    rows = [
        Row(SECTION, "Fig. 4.10: shift of the mode, hysteresis ignored", None,
            shift_percent(ignored), "%", "the thesis shows a lower one, without a figure"),
        Row(SECTION, "Fig. 4.10: shift of the mode, hysteresis known", None,
            shift_percent(known), "%"),
        Row(SECTION, "Fig. 4.10: lag of the hysteresis, taken for dynamics", None,
            float(np.degrees(-np.angle(np.mean(by_voltage / by_hysteresis)))), "degrees"),
        Row(SECTION, "Fig. 4.10: time constant, hysteresis ignored", 1e-3,
            ignored.time_constant_s, "s", "the thesis' figure is the true one"),
        Row(SECTION, "Fig. 4.10: DC gain of the fit to the chirp", None, gain, "um/V",
            "that of the dynamics is 1, that of the hysteresis in the last row"),
        Row(SECTION, "Fig. 4.10: gain of the hysteresis, a fifth of the amplitude", None, small,
            "um/V", "the DC gain depends on the amplitude"),
        Row(SECTION, "Fig. 4.10: gain of the hysteresis, full amplitude", None, large, "um/V"),
    ]
    fitted = gain * ignored.response(frequency_hz)
    return Study(rows, {"4.10": _draw(plant, frequency_hz, by_voltage, fitted)})


def fit_response(frequency_hz, response):
    """Fit a gain, a lag and a mode, without a delay, to a frequency response."""
    def dynamics(logarithms):
        time_constant_s, rate_rad_per_s, damping = np.exp(logarithms)
        return ElectricVibrationDynamics(time_constant_s, (rate_rad_per_s,), (damping,))

    def residual(logarithms):
        error = np.exp(logarithms[0]) * dynamics(logarithms[1:]).response(frequency_hz) - response
        return np.concatenate([error.real, error.imag])

    peak_rad_per_s = 2.0 * np.pi * frequency_hz[np.argmax(np.abs(response))]
    start = np.log([np.abs(response[0]), 1.0 / peak_rad_per_s, peak_rad_per_s, 0.1])
    solution = least_squares(residual, start).x
    return float(np.exp(solution[0])), dynamics(solution[1:])


def _response(input, output):
    """Return frequencies and response from averaged spectra."""
    frequency_hz, cross = csd(input, output, CLOCK_HZ, nperseg=SEGMENT)
    _, power = welch(input, CLOCK_HZ, nperseg=SEGMENT)
    # Compensate the hold of the input, which delays by half a sample.
    lead = np.exp(1j * np.pi * frequency_hz / CLOCK_HZ)
    inside = (frequency_hz > 1.1 * BAND_HZ[0]) & (frequency_hz < 0.9 * BAND_HZ[1])
    return frequency_hz[inside], (lead * cross / power)[inside]


def _first_gain(hysteresis, span_v):
    """Return the gain of the fundamental for a sine between 0 V and `span_v`."""
    phase = 2.0 * np.pi * np.arange(2000) / 1000
    output_um = hysteresis.simulate(0.5 * span_v * (1.0 - np.cos(phase)))[1000:]
    return float(abs(2.0 * np.mean(output_um * np.exp(-1j * phase[1000:])) / (0.5 * span_v)))


def _draw(plant, frequency_hz, measured, fitted):
    figure = new_figure(3.6)
    above, below = figure.subplots(2, 1, sharex=True)
    for response, style in (
        (plant.dynamics.response(frequency_hz), {**MEASURED, "label": "true dynamics"}),
        (measured, {"color": ORANGE, "linestyle": ":", "label": "measured from the voltage"}),
        (fitted, {**MODELLED, "label": "fitted, hysteresis ignored"}),
    ):
        above.semilogy(frequency_hz, np.abs(response), **style)
        below.plot(frequency_hz, np.degrees(np.unwrap(np.angle(response))), **style)
    above.legend()
    label(above, y="gain (um/um)")
    label(below, "frequency (Hz)", "phase (degrees)")
    plain_numbers(above.yaxis)
    return figure
