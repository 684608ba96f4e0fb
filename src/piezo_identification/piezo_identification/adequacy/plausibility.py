# SPDX-License-Identifier: BSD-3-Clause
"""What is implausible in a recording or a model of a piezo stage, in sentences for people."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class PlausibilitySettings:
    """What stages and sensors do not do.

    Attributes
    ----------
    stuck_while_v : float
        Part of the voltage's range that moves while a sensor stands at its end: clipping.
    stuck_samples : int
        Equal samples at the end of a sensor's range, at a resting voltage, that may be chance.
    stuck_ratio : float
        By which they outnumber equal samples elsewhere, where noise tells them apart.
    coarse : float
        Part of the displacement's range; a sensor whose steps are larger is coarse, not clipped.
    samples_while_fast : float
        Samples that the fast dynamics need within `WAVEFORM.slow_branch_s`, in which they settle.
    small_range_um, small_gain_um_per_v : float
        Below both, a stage hardly moves: such as metres, or millimetres, taken for micrometres.
    large_range_um, large_gain_um_per_v : float
        Above either, it moves too far: such as nanometres taken for micrometres.
    large_voltage_v : float
        Above it, no piezo stage is driven: such as millivolts taken for volts.
    """

    stuck_while_v: float = 0.03
    stuck_samples: int = 8
    stuck_ratio: float = 5.0
    coarse: float = 3e-3
    samples_while_fast: float = 10.0
    small_range_um: float = 0.5
    small_gain_um_per_v: float = 5e-3
    large_range_um: float = 1e4
    large_gain_um_per_v: float = 50.0
    large_voltage_v: float = 5e3


SETTINGS = PlausibilitySettings()


def implausible_data(recordings: Mapping[str, Any]) -> list[str]:
    """Tell what is implausible in recordings, whatever model is made of them.

    Parameters
    ----------
    recordings : dict of str to Recording or FrequencyResponse
        By the name of the experiment.

    Returns
    -------
    list of str
    """
    told = []
    for name, data in recordings.items():
        if isinstance(data, FrequencyResponse):
            continue
        told += [f"{data.path}: {text}" for text in _clipping(data)]
        slowest_s = WAVEFORM.slow_branch_s / SETTINGS.samples_while_fast
        period_s = float(np.median(data.sample_periods_s[data.playing]))
        if name == "dynamics" and period_s > slowest_s:
            told.append(
                f"{data.path}: a sample every {period_s:.3g} s is too slow to hold dynamics, which "
                f"settle within {WAVEFORM.slow_branch_s:g} s: give a recording with a sample every "
                f"{slowest_s:g} s or faster, or leave --dynamics out")
    return told


def implausible_model(model: StageModel, recordings: Mapping[str, Any]) -> list[str]:
    """Tell what is implausible in a model of a piezo stage.

    Parameters
    ----------
    model : StageModel
    recordings : dict of str to Recording or FrequencyResponse
        It was made from, by the name of the experiment.

    Returns
    -------
    list of str
    """
    told, dynamics = [], model.dynamics
    slow_s = WAVEFORM.slow_branch_s
    what = ""
    if dynamics.time_constant_s > slow_s:
        what = f"a time constant of {dynamics.time_constant_s:.3g} s"
    elif min(dynamics.mode_frequencies_rad_per_s, default=np.inf) * slow_s < 1.0:
        what = f"a mode at {min(dynamics.mode_frequencies_rad_per_s) / (2.0 * np.pi):.3g} Hz"
    if what and "dynamics" in recordings:
        told.append(
            f"{what} is too slow for the dynamics of a piezo stage, which settle within "
            f"{slow_s:g} s: is {recordings['dynamics'].path} a recording of the dynamics, with its "
            "time in seconds?")
    low_um, high_um = model.hysteresis.output_range_um
    low_v, high_v = model.hysteresis.voltage_min_v, model.hysteresis.voltage_max_v
    range_um, gain = high_um - low_um, (high_um - low_um) / (high_v - low_v)
    if (range_um < SETTINGS.small_range_um and gain < SETTINGS.small_gain_um_per_v) or (
            range_um > SETTINGS.large_range_um or gain > SETTINGS.large_gain_um_per_v):
        told.append(
            f"a range of {range_um:.3g} um over {high_v - low_v:.4g} V is implausible for a piezo "
            "stage: is the displacement in um, and the voltage in V?")
    if max(abs(low_v), abs(high_v)) > SETTINGS.large_voltage_v:
        told.append(f"voltages from {low_v:.4g} to {high_v:.4g} V are implausible for a piezo "
                    "stage: is the voltage in V?")
    return told


def _clipping(recording: Recording) -> list[str]:
    displacement_um = np.asarray(recording.displacement_um, dtype=float)
    voltage_v = np.asarray(recording.voltage_v, dtype=float)
    if _is_coarse(displacement_um):
        return []
    starts = np.flatnonzero(np.diff(displacement_um, prepend=np.nan) != 0.0)
    lengths = np.diff(np.append(starts, displacement_um.size))
    told = []
    for word, end_um in (("largest", displacement_um.max()), ("smallest", displacement_um.min())):
        at_end = displacement_um[starts] == end_um
        if not _is_stuck(voltage_v, starts, lengths, at_end):
            continue
        share = np.sum(lengths[at_end]) / displacement_um.size
        told.append(
            f"the sensor clips: {100.0 * share:.3g} % of the displacements are exactly the "
            f"{word}, {end_um:.6g} um, while the stage must move: extend the range of the sensor, "
            "or lower the voltage, and record again")
    return told


def _is_coarse(displacement_um: FloatArray) -> bool:
    """Whether the smallest step between readings is large: a coarse sensor stands still, too."""
    steps_um = np.diff(np.unique(displacement_um))
    return steps_um.size == 0 or bool(
        steps_um.min() > SETTINGS.coarse * np.ptp(displacement_um))


def _is_stuck(voltage_v: FloatArray, starts: NDArray[np.intp], lengths: NDArray[np.intp],
              at_end: NDArray[np.bool_]) -> bool:
    """Whether the displacement stands at its end while the voltage moves, or noise is missing."""
    moved_v = np.maximum.reduceat(voltage_v, starts) - np.minimum.reduceat(voltage_v, starts)
    if np.any(moved_v[at_end] > SETTINGS.stuck_while_v * np.ptp(voltage_v)):
        return True
    at_rest = moved_v == 0.0
    elsewhere = lengths[~at_end & at_rest].max(initial=1)
    most = max(SETTINGS.stuck_samples, SETTINGS.stuck_ratio * elsewhere)
    # A stage without noise may rest once before it first moves; a sensor clips again.
    return bool(np.count_nonzero(lengths[at_end & at_rest] > most) > 1)
