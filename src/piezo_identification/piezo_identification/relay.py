# SPDX-License-Identifier: BSD-3-Clause
"""Relay feedback for the ultimate frequency (thesis 3.4.2, Fig. 3.7)."""

import numpy as np
from scipy.optimize import brentq

from piezo_identification.waveforms import played

SETTLING_CYCLES = 5
"""Cycles at the start that are not counted."""

HIGHEST_HZ = 1e5
"""Frequency up to which the phase of a model is followed."""


def relay_feedback(exchange, low_v, high_v, threshold_um, samples):
    """Let a relay oscillate with the stage: the high voltage whenever the stage is below.

    Parameters
    ----------
    exchange : callable
        Takes voltages, shape (1,), plays them, and returns as many displacements measured before
        they act: the `exchange` of a stage backend.
    low_v, high_v : float
        Voltages of the relay.
    threshold_um : float
        Displacement at which it switches.
    samples : int
        Length of the experiment on the sample clock.

    Returns
    -------
    voltage_v, displacement_um : ndarray, shape (samples,)
    """
    voltage_v, displacement_um = np.empty(samples), np.empty(samples)
    command_v = high_v
    for n in range(samples):
        voltage_v[n] = command_v
        displacement_um[n] = exchange(np.array([command_v]))[0]
        command_v = low_v if displacement_um[n] > threshold_um else high_v
    return voltage_v, displacement_um


def ultimate_frequency_hz(recording):
    """Frequency at which a stage in relay feedback oscillates.

    The relay's describing function is real, so that the phase of the stage is -180 degrees there,
    but for the hysteresis and the delay of the relay.

    Parameters
    ----------
    recording : Recording
        Of a voltage that switches between two values.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the voltage takes other values, or does not oscillate steadily.
    """
    part = played(recording)
    voltage_v = part.voltage_v
    high = voltage_v > 0.5 * (voltage_v.min() + voltage_v.max())
    if not np.all((voltage_v == voltage_v.min()) | (voltage_v == voltage_v.max())):
        raise ValueError(
            f"{recording.path} has more than two voltages: give the recording of a relay"
        )
    rises = part.time_s[1:][high[1:] & ~high[:-1]][SETTLING_CYCLES:]
    if rises.size < 3:
        raise ValueError(
            f"{recording.path} does not oscillate for {SETTLING_CYCLES + 3} cycles: put the "
            "relay's threshold within the travel between its voltages, or record longer"
        )
    periods_s = np.diff(rises)
    if np.ptp(periods_s) > 0.5 * np.median(periods_s):
        raise ValueError(
            f"{recording.path} does not oscillate steadily, its periods go from "
            f"{periods_s.min():.3g} to {periods_s.max():.3g} s: use a larger step of the relay"
        )
    return float(1.0 / periods_s.mean())


def model_ultimate_frequency_hz(response, delay_s=0.0):
    """Lowest frequency at which the phase of a model reaches -180 degrees.

    Parameters
    ----------
    response : callable
        Complex response at frequencies in Hz, such as the method of a model; positive at the
        lowest ones.
    delay_s : float
        Further delay of the loop: a relay that holds its voltage for a sample period delays by
        one and a half of them, one for the measurement and half for the hold.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the phase does not go that far.
    """
    def delayed(frequency_hz):
        return response(frequency_hz) * np.exp(-2j * np.pi * frequency_hz * delay_s)

    frequency_hz = np.geomspace(1e-2, HIGHEST_HZ, 20_000)
    phase = np.unwrap(np.angle(delayed(frequency_hz)))
    below = np.flatnonzero(phase <= -np.pi)
    if below.size == 0:
        raise ValueError(
            f"the phase of the model stays above -180 degrees up to {HIGHEST_HZ:g} Hz: a relay "
            "does not make it oscillate"
        )
    # Turned by half a circle, the phase crosses zero without a jump.
    bracket = frequency_hz[below[0] - 1 : below[0] + 1]
    return float(brentq(lambda f: np.angle(-delayed(np.array(f))), *bracket))
