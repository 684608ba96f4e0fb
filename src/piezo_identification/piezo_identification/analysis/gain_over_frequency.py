# SPDX-License-Identifier: BSD-3-Clause
"""The response from one signal to another, estimated from their spectra."""

import numpy as np
from scipy.fft import prev_fast_len
from scipy.signal import welch

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.sensor_noise import spectra_of_segments

LINES = 2048
"""Most samples of a segment for a spectrum; short signals have shorter segments."""

SEGMENTS, SHORTEST_SEGMENT = 8, 256
"""Number of segments of a signal whose spectra are averaged, and fewest samples of one."""

EXCITED = 1e-4
"""Smallest power of an excited line, as a fraction of the largest power of the input."""

MOST_OF_IT = (0.1, 0.9)
"""Quantiles of the power that limit the band named for a residual."""


def gain_of(input: FloatArray, output: FloatArray, sample_period_s: float,
            segment: int | None = None, least_power: float = EXCITED,
            ) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Estimate the response from one signal, (N,), to another at the excited lines.

    Each averaged segment has so many samples; by default a quarter of all, up to `LINES`. An
    excited line has at least `least_power` of the largest power of the input. Return frequencies in
    Hz, the response, and the fraction of the output power that is coherent with the input, (M,).
    """
    size = min(segment or min(LINES, max(16, input.size // 4)), input.size)
    lines = size // 2 + 1
    crossed = np.zeros(lines, dtype=complex)
    of_input, of_output = np.zeros(lines), np.zeros(lines)
    for driving, answering in zip(spectra_of_segments(input, size, 1),
                                  spectra_of_segments(output, size, 1), strict=True):
        crossed += np.sum(np.conj(driving) * answering, axis=0)
        of_input += np.sum(np.abs(driving) ** 2, axis=0)
        of_output += np.sum(np.abs(answering) ** 2, axis=0)
    excited = of_input > least_power * of_input.max()
    excited[0] = False
    crossed, of_input, of_output = crossed[excited], of_input[excited], of_output[excited]
    coherence = np.abs(crossed) ** 2 / np.maximum(of_input * of_output, np.finfo(float).tiny)
    return np.fft.rfftfreq(size, sample_period_s)[excited], crossed / of_input, coherence


def spectrum(signal_um: FloatArray, sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (Hz) and power spectral density (um^2/Hz) of a signal, (N,)."""
    return welch(signal_um, 1.0 / sample_period_s, nperseg=segment_of(signal_um.size),
                 detrend="linear")


def segment_of(samples: int) -> int:
    """Return the number of samples of each segment for averaging spectra."""
    # A length with large prime factors takes several times as long.
    longest = prev_fast_len(max(1, samples // SEGMENTS), real=True)
    return int(min(samples, max(SHORTEST_SEGMENT, longest)))


def band_of_most(frequency_hz: FloatArray, power: FloatArray) -> tuple[float, float]:
    """Return the band in Hz with most of the power at increasing frequencies, both (M,)."""
    below = np.cumsum(power)
    low_hz, high_hz = frequency_hz[np.searchsorted(
        below, [share * below[-1] for share in MOST_OF_IT])]
    return float(low_hz), float(high_hz)
