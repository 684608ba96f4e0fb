# SPDX-License-Identifier: BSD-3-Clause
"""Frequency response of the linear dynamics, measured with a square wave."""

import numpy as np

from piezo_identification.conditioning.waveforms import played, square_wave

WARM_UP_PERIODS = 5
# Smallest ratio of a harmonic to its standard error for which it is used.
CLEARANCE = 10.0


def square_wave_response(model, recording):
    """Divide the displacement's harmonics by those of the hysteresis' output.

    Parameters
    ----------
    model : StageModel
        Model that gives the output of the hysteresis at the two levels of the square wave.
    recording : Recording
        Recording of the dynamics experiment.

    Returns
    -------
    frequency_hz : ndarray, shape (N,)
        Odd multiples of the square wave's frequency that exceed the noise.
    response : ndarray, shape (N,), complex

    Raises
    ------
    ValueError
        If the recording holds no square wave, or too few periods of it.
    """
    part = played(recording)
    period = _period_samples(part)
    periods = part.voltage_v.size // period - WARM_UP_PERIODS
    if periods < 1:
        raise ValueError(f"{recording.path} has too few periods of the square wave: record longer")
    kept = slice(WARM_UP_PERIODS * period, (WARM_UP_PERIODS + periods) * period)

    def odd_harmonics(signal):
        return np.fft.rfft(signal[kept].reshape(periods, period))[:, 1::2]

    driven = odd_harmonics(model.hysteresis.simulate(part.voltage_v)).mean(axis=0)
    answered = odd_harmonics(part.displacement_um)
    standard_error = answered.std(axis=0) / np.sqrt(periods)
    answered = answered.mean(axis=0)
    clear = np.abs(answered) > CLEARANCE * standard_error
    frequency_hz = np.fft.rfftfreq(period, part.sample_period_s)[1::2]
    return frequency_hz[clear], (answered / driven)[clear]


def _period_samples(part):
    steps = square_wave(part).steps
    if steps.size < 3:
        raise ValueError(f"{part.path} has too few periods of the square wave: record longer")
    return int(steps[2] - steps[0])
