# SPDX-License-Identifier: BSD-3-Clause
"""Spectra of segments beside those of SciPy, which transforms one after the other."""

import numpy as np
import pytest
from scipy.signal import csd, welch

from piezo_identification.analysis.gain_over_frequency import gain_of
from piezo_identification.conditioning.sensor_noise import noise_floor_um

PERIOD_S = 5e-5


@pytest.fixture(params=[40, 1000, 300_001])
def signals(request):
    driving = np.random.default_rng(0).normal(size=request.param).cumsum()
    answer = np.convolve(driving, [0.3, 0.5, 0.1])[: request.param]
    return driving, answer + np.random.default_rng(1).normal(size=request.param)


def test_a_gain_is_that_of_welch_and_csd(signals):
    driving, answer = signals
    options = {"fs": 1.0 / PERIOD_S, "detrend": "linear",
               "nperseg": min(2048, max(16, driving.size // 4))}
    crossed_hz, crossed = csd(driving, answer, **options)
    of_input, of_output = (welch(signal, **options)[1] for signal in signals)
    frequency_hz, gain, coherence = gain_of(driving, answer, PERIOD_S)
    shown = np.isin(crossed_hz, frequency_hz)
    assert np.count_nonzero(shown) == frequency_hz.size > 5
    np.testing.assert_allclose(gain, (crossed / of_input)[shown], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        coherence, (np.abs(crossed) ** 2 / of_input / of_output)[shown], rtol=1e-9)


def test_a_noise_floor_is_that_of_the_median_of_welch(signals):
    residual = signals[1] - signals[0]
    segment = min(256, residual.size)
    _, density = welch(residual, 1.0 / PERIOD_S, nperseg=segment, average="median")
    upper = density[(density.size - 1) // 2 + 1 : -1]
    quietest = min(np.median(part) for part in np.array_split(upper, 4))
    assert noise_floor_um(residual) == pytest.approx(np.sqrt(0.5 * quietest / PERIOD_S))
