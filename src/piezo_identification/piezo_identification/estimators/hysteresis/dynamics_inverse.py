# SPDX-License-Identifier: BSD-3-Clause
"""The inverse of electric and vibration dynamics for cycles that are fast compared with them."""

import numpy as np
from scipy.fft import next_fast_len

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.settling import low_frequency_delay_s
from piezo_models.linear.dynamics import ElectricVibrationDynamics

SLOW_ERROR = 1e-3
"""Largest error of the inverse at low frequency, relative to the RMS voltage."""

LEAST_GAIN = 0.3
"""Gain of the dynamics below which the inverse is damped, to limit the noise."""

DOUBLINGS = 2
"""Number of times that the iterations of the damped inverse are doubled: four in total, which leave
an error of 5e-5 where the gain is 1."""

TAPER_SHARE = 0.1
"""Share of the record that is added to lead from its end back to its beginning."""


def follows_fast(
    voltage_v: FloatArray, dynamics: ElectricVibrationDynamics, sample_period_s: float,
) -> bool:
    """Return whether a voltage, (N,), is too fast for the low-frequency inverse of the dynamics."""
    if dynamics.is_static:
        return False
    spectrum = np.abs(np.fft.rfft(np.hanning(voltage_v.size) * (voltage_v - voltage_v.mean())))
    frequency_hz = np.fft.rfftfreq(voltage_v.size, sample_period_s)
    rate = 2j * np.pi * frequency_hz
    error = dynamics.response(frequency_hz) * (1.0 + low_frequency_delay_s(dynamics) * rate) - 1.0
    missed = np.linalg.norm(spectrum * error)
    return bool(missed > SLOW_ERROR * np.linalg.norm(spectrum))


def remove_dynamics(
    displacement_um: FloatArray, voltage_v: FloatArray, dynamics: ElectricVibrationDynamics,
    sample_period_s: float, delay_s: float = 0.0,
) -> FloatArray:
    """Return the input of the dynamics, (N,), as values held from each sample on.

    The inverse is the stable, non-causal one of Wiener: ``conj(D) / (|D|^2 + e^2)``. It is applied
    to the residual of the displacement after fitting a line in the voltage, both (N,). The response
    to the line is calculated, so that the damping of high frequencies only affects the small
    residual. Each displacement is measured before its voltage acts.
    """
    added = samples_added(voltage_v.size)
    frequency_hz: FloatArray = np.fft.rfftfreq(
        voltage_v.size + added, sample_period_s).astype(float)
    forward = held_response(dynamics, frequency_hz, sample_period_s, delay_s)
    through = np.fft.irfft(
        np.fft.rfft(closed_signal(voltage_v)) * forward, voltage_v.size + added)
    basis = np.column_stack([through[: voltage_v.size], np.ones(voltage_v.size)])
    slope, offset = np.linalg.lstsq(basis, displacement_um, rcond=None)[0]
    return slope * voltage_v + offset + input_of(displacement_um - basis @ [slope, offset], forward)


def input_of(output_um: FloatArray, forward: ComplexArray) -> FloatArray:
    """Return the input of a system for its output, both (N,), with little noise.

    Its response `forward` is that at the lines of the `closed_signal`. See `remove_dynamics`.
    """
    closed_um = closed_signal(output_um)
    inverse = forward.conj() / (np.abs(forward) ** 2 + LEAST_GAIN**2)
    for _ in range(DOUBLINGS):
        # Each squares the remaining error e^2 / (|D|^2 + e^2), which is small where D is about 1.
        inverse = inverse * (2.0 - inverse * forward)
    return np.fft.irfft(np.fft.rfft(closed_um) * inverse, closed_um.size)[: output_um.size]


def held_response(
    dynamics: ElectricVibrationDynamics, frequency_hz: FloatArray, sample_period_s: float,
    delay_s: float = 0.0,
) -> ComplexArray:
    """Response from held values to delayed samples, (N,), where images of the hold are small."""
    turn = frequency_hz * sample_period_s
    return dynamics.response(frequency_hz) * np.sinc(turn) * np.exp(
        -1j * np.pi * (turn + 2.0 * frequency_hz * delay_s))


def samples_added(count: int) -> int:
    """Return the number of samples that `closed_signal` adds to a signal of given length.

    It is a tenth, plus what gives a length with small prime factors: the transform of other lengths
    takes five times as long.
    """
    return int(next_fast_len(count + max(2, int(TAPER_SHARE * count)), real=True)) - count


def closed_signal(signal: FloatArray) -> FloatArray:
    """Add a smooth way of `samples_added` back from the end of a signal to its beginning.

    The signal has the shape (N,) or (N, K).
    """
    added = samples_added(len(signal))
    way = 0.5 - 0.5 * np.cos(np.pi * (np.arange(added) + 1.0) / (added + 1.0))
    way = way.reshape(-1, *[1] * (signal.ndim - 1))
    return np.concatenate([signal, signal[-1] + (signal[0] - signal[-1]) * way])
