# SPDX-License-Identifier: BSD-3-Clause
"""The zero-order hold in a measured frequency response: what it is, and how it is taken out.

A response from voltage samples, each held for a sample period, to displacement samples is that of
the sampled system. It lags half a sample period behind the stage's own. A model that took this lag
for a delay of the stage would be late twice when it is simulated from samples.
"""

from dataclasses import replace

import control
import numpy as np

from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.simulation.sampled_response import delayed_zoh


def hold_response(frequency_hz: np.ndarray, hold_s: float) -> np.ndarray:
    """Return the response (1 - exp(-s T)) / (s T) of a zero-order hold.

    Parameters
    ----------
    frequency_hz : ndarray, shape (N,)
    hold_s : float
        T.

    Returns
    -------
    ndarray of complex, shape (N,)
    """
    return np.exp(-1j * np.pi * frequency_hz * hold_s) * np.sinc(frequency_hz * hold_s)


def sampled_response(system: control.StateSpace, delay_s: float, frequency_hz: np.ndarray,
                     hold_s: float) -> np.ndarray:
    """Return the response from held voltage samples to displacement samples, aliases included.

    Parameters
    ----------
    system : control.StateSpace
        Continuous.
    delay_s : float
        Behind it.
    frequency_hz : ndarray, shape (N,)
    hold_s : float
        Sample period.

    Returns
    -------
    ndarray of complex, shape (N,)
    """
    discrete, late = delayed_zoh(system, hold_s, delay_s)
    z = np.exp(2j * np.pi * frequency_hz * hold_s)
    return discrete(z, squeeze=True) * z**-late


def without_hold(measured: FrequencyResponse, system: control.StateSpace | None = None,
                 delay_s: float = 0.0) -> FrequencyResponse:
    """Return a measured response as that of the stage alone.

    Parameters
    ----------
    measured : FrequencyResponse
        One without hold is returned as it is.
    system : control.StateSpace, optional
        Continuous; about that of the stage. It determines what sampling folds back from beyond half
        the sample rate, which is little where the response falls fast; left out, that is not
        corrected.
    delay_s : float
        Behind the system.

    Returns
    -------
    FrequencyResponse
        Without hold.
    """
    if not measured.hold_s:
        return measured
    frequency_hz, hold_s = measured.frequency_hz, measured.hold_s
    factor = hold_response(frequency_hz, hold_s)
    if system is not None:
        s = 2j * np.pi * frequency_hz
        factor = sampled_response(system, delay_s, frequency_hz, hold_s) / (
            system(s, squeeze=True) * np.exp(-s * delay_s))
    return replace(measured, gain=measured.gain / factor, hold_s=0.0)
