# SPDX-License-Identifier: BSD-3-Clause
"""The zero-order hold in a measured frequency response, and its removal.

A response from held voltage samples to displacement samples is that of the sampled system. It lags
that of the stage by half a sample period. A model that attributed this lag to the stage would apply
it twice when it is simulated from samples.
"""

from dataclasses import replace

import control
import numpy as np

from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.simulation.sampled_response import (
    behind_lags,
    delayed_zoh,
    leading_lags,
)
from piezo_models.cascade import StageModel


def hold_response(frequency_hz: np.ndarray, hold_s: float) -> np.ndarray:
    """Return the response (1 - exp(-s T)) / (s T) of a hold of T at frequencies, (N,)."""
    return np.exp(-1j * np.pi * frequency_hz * hold_s) * np.sinc(frequency_hz * hold_s)


def sampled_response(system: control.StateSpace, delay_s: float, frequency_hz: np.ndarray,
                     hold_s: float) -> np.ndarray:
    """Return the response from held voltage samples to displacement samples, (N,), with aliases."""
    discrete, late = delayed_zoh(system, hold_s, delay_s)
    z = np.exp(2j * np.pi * frequency_hz * hold_s)
    return discrete(z, squeeze=True) * z**-late


def without_hold(measured: FrequencyResponse, system: control.StateSpace | None = None,
                 delay_s: float = 0.0) -> FrequencyResponse:
    """Return a measured response converted to that of the stage alone.

    A response without hold is returned unchanged. An approximate continuous system of the stage
    determines the aliases from above half the sample rate, which are small if the response falls
    fast; by default they are not corrected.
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


def of_the_stage(measured: FrequencyResponse, model: StageModel) -> FrequencyResponse:
    """Return a measured response without its hold, whose aliases a model determines."""
    lags, _ = leading_lags(model.effects_at("displacement") + model.effects_at("sensor"), 1)
    return without_hold(measured, *behind_lags(model.linear(), lags))
