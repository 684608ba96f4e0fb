# SPDX-License-Identifier: BSD-3-Clause
"""Find implausible recordings for an experiment, and implausible models of a piezo stage."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from piezo_identification.conditioning.segments import experiment_of
from piezo_identification.conditioning.settling import (
    low_frequency_delay_s,
    slow_delay_s,
    slow_dynamics,
)
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_identification.conditioning.waveforms import SLOWEST_FAST_ROWS_S
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.cascade import StageModel
from piezo_recorder.reading.plausibility import USUAL, implausible


def implausible_data(recordings: Mapping[str, Any]) -> list[str]:
    """Return sentences on implausible data, given by name of the experiment.

    Those that are already in the notes of the recordings are left out.
    """
    sentences = []
    for name, data in recordings.items():
        if isinstance(data, FrequencyResponse):
            continue
        found = [f"{data.path}: {text}" for text in implausible(data)]
        sentences += [text for text in found if text not in data.notes]
        period_s = float(np.median(data.sample_periods_s[data.playing]))
        if experiment_of(name) == "dynamics" and period_s > SLOWEST_FAST_ROWS_S:
            sentences.append(
                f"{data.path}: a sample every {period_s:.3g} s is too slow to hold dynamics, which "
                f"settle within {WAVEFORM.slow_branch_s:g} s: give a recording with a sample every "
                f"{SLOWEST_FAST_ROWS_S:g} s or faster, or leave --dynamics out")
    return sentences


def implausible_model(model: StageModel, recordings: Mapping[str, Any]) -> list[str]:
    """Return sentences on what is implausible in a model of a piezo stage.

    The data of the identification are given by name of the experiment.
    """
    sentences, dynamics = [], model.dynamics
    slow_s = WAVEFORM.slow_branch_s
    # A time constant alone says little: coupled modes may compensate it.
    lag_s = low_frequency_delay_s(slow_dynamics(dynamics, model.effects)) + slow_delay_s(
        dynamics, model.effects)
    what = ""
    if min(dynamics.mode_frequencies_rad_per_s, default=np.inf) * slow_s < 1.0:
        what = f"a mode at {min(dynamics.mode_frequencies_rad_per_s) / (2.0 * np.pi):.3g} Hz"
    elif lag_s > slow_s:
        what = f"a lag of {lag_s:.3g} s"
    if what and "dynamics" in recordings:
        sentences.append(
            f"{what} is too slow for the dynamics of a piezo stage, which settle within "
            f"{slow_s:g} s: is {recordings['dynamics'].path} a recording of the dynamics, with its "
            "time in seconds?")
    low_v, high_v = model.hysteresis.voltage_min_v, model.hysteresis.voltage_max_v
    range_um, gain = model.hysteresis.travel_um, model.hysteresis.mean_gain_um_per_v
    # A response does not contain the voltages of the stage.
    has_range = any(not isinstance(data, FrequencyResponse) for data in recordings.values())
    what = (f"a range of {range_um:.3g} um over {high_v - low_v:.4g} V" if has_range
            else f"a gain of {gain:.3g} um/V")
    if (range_um < USUAL.least_range_um and gain < USUAL.least_gain_um_per_v) or (
            has_range and range_um > USUAL.largest_range_um) or gain > USUAL.largest_gain_um_per_v:
        sentences.append(f"{what} is implausible for a piezo stage: is the displacement in um, and "
                         "the voltage in V?")
    if max(abs(low_v), abs(high_v)) > USUAL.largest_voltage_v:
        sentences.append(f"voltages from {low_v:.4g} to {high_v:.4g} V are implausible for a piezo "
                         "stage: is the voltage in V?")
    return sentences
