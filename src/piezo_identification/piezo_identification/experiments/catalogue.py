# SPDX-License-Identifier: BSD-3-Clause
"""The named experiments of the identification: which voltage is played, and how fast.

Other packages can add experiments through entry points of the group
`piezo_identification.experiments`.

The function of each experiment raises ValueError if its waveform leaves the range or exceeds the
slew limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.registered import registered
from piezo_identification.experiments.input_designs import (
    arc,
    diagnostic_block,
    distortion_period,
    stair_amplitudes,
    stair_harmonics,
)
from piezo_identification.experiments.relay_feedback import RelayExperiment, relay
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits

SWING_FRACTION = 0.3
"""Step of the square waves as a fraction of the voltage range; the slew limit can reduce it."""

VALIDATION_TURNS = (0.0, 0.836, 0.236, 0.747, 0.305, 0.652, 0.415, 0.933, 0.09, 0.585, 0.207, 0.5)
"""Turning points of the slow validation part as fractions of the voltage range, between levels."""

VALIDATION_TONES = ((100.0, 0.06), (300.0, 0.03), (400.0, 0.03), (500.0, 0.03), (1000.0, 0.03))
"""Frequency (Hz) and amplitude, as a fraction of the voltage range, of each validation tone."""

MULTISINE_TURNS = (0.0, 0.5)
MULTISINE_TONES = (
    (100.0, 0.05), (200.0, 0.1), (300.0, 0.05), (400.0, 0.05), (500.0, 0.05), (600.0, 0.05)
)
"""Frequency (Hz) and amplitude, as a fraction of the voltage range, proportioned as in the
thesis."""


@dataclass(frozen=True)
class Experiment:
    """A voltage waveform with the purpose it serves."""

    name: str
    """Name that selects the experiment."""
    voltage_v: FloatArray = field(repr=False)
    """One run of the waveform, each value held for `sample_period_s`, (N,) or (N, axes)."""
    sample_period_s: float
    """Whole multiple of the sample clock's period."""
    repeats: int
    """How often the waveform is played."""
    description: str
    """One line for users."""
    settling_repeats: int = 0
    """Number of repeats until the motion has settled. If it is not 0, the later repeats are equal
    periods."""

    @property
    def duration_s(self) -> float:
        """Return the duration of all repeats, without the ramps from and to rest."""
        return len(self.voltage_v) * self.sample_period_s * self.repeats

    def parameters(self) -> dict[str, float]:
        """Return the parameters to store with a recording of the experiment."""
        settling = {"settling_repeats": self.settling_repeats} if self.settling_repeats else {}
        return {"sample_period_s": self.sample_period_s, "repeats": self.repeats,
                "samples": len(self.voltage_v), **settling}


def creep(
    limits: StageLimits = USUAL_LIMITS, period_s: float = 400.0, sample_period_s: float = 0.01,
    periods: int = 1, swing_v: float | None = None,
) -> Experiment:
    """Design a long square wave, which shows the creep (thesis 4.5).

    It begins at the upper level. The loop between the levels is then closed from the first sample
    on, and the hysteresis has exactly two outputs, as (4.5) requires.

    Parameters
    ----------
    period_s, sample_period_s : float
        Period of the square wave and time for which each value is held.
    periods : int
        Number of periods.
    swing_v : float, optional
        Difference of the two levels, which lie around the middle of the range.
    """
    voltage_v = _square_wave(limits, period_s, sample_period_s, swing_v)
    return fitting(
        limits, Experiment("creep", voltage_v, sample_period_s, periods,
                           f"square wave of {period_s:g} s between two levels")
    )


def dynamics(
    limits: StageLimits = USUAL_LIMITS, period_s: float = 0.02, duration_s: float = 2.0,
    swing_v: float | None = None,
) -> Experiment:
    """Design a short square wave at the full sample clock, which shows the fast dynamics.

    Parameters
    ----------
    period_s, duration_s : float
        Period of the square wave and duration of the experiment.
    swing_v : float, optional
        Difference of the two levels, which lie around the middle of the range.
    """
    sample_period_s = 1.0 / limits.sample_rate_hz
    voltage_v = _square_wave(limits, period_s, sample_period_s, swing_v)
    return fitting(
        limits, Experiment("dynamics", voltage_v, sample_period_s, round(duration_s / period_s),
                           f"square wave of {1e3 * period_s:g} ms between two levels")
    )


def hysteresis(
    limits: StageLimits = USUAL_LIMITS, level_count: int = 70, harmonic_period_s: float = 2.0,
    sample_period_s: float = 0.001,
) -> Experiment:
    """Design harmonics of rising amplitude (4.6)-(4.8) that cover the whole voltage range.

    Harmonic i rises from the lowest voltage to level i and returns, so each begins and ends at
    negative saturation, where the memory is known.

    Parameters
    ----------
    level_count : int
        Number of harmonics L; the levels are L + 1 with level 0.
    harmonic_period_s, sample_period_s : float
        Period T_sub of each harmonic and time for which each value is held.
    """
    samples = round(harmonic_period_s / sample_period_s)
    stairs_v = stair_harmonics(
        np.arange(level_count * samples) / samples,
        stair_amplitudes(level_count, limits.span_v), 1.0)
    voltage_v = limits.voltage_min_v + np.append(stairs_v, 0.0)
    return fitting(
        limits, Experiment("hysteresis", voltage_v, sample_period_s, 1,
                           f"{level_count} harmonics of rising amplitude over the whole range")
    )


def validation(
    limits: StageLimits = USUAL_LIMITS, arc_s: float = 0.25, tones_s: float = 1.0,
    tones: Sequence[Sequence[float]] = VALIDATION_TONES,
) -> Experiment:
    """Design a validation input: slow arcs between the levels of the hysteresis, then tones.

    It begins at the lowest voltage, where the memory of the hysteresis is known.

    Parameters
    ----------
    arc_s : float
        Time from one turning point to the next.
    tones_s : float
        Duration of the tones.
    tones : sequence of (float, float)
        Frequency (Hz) and amplitude, as a fraction of the voltage range, of each tone.
    """
    voltage_v = _arcs_and_tones(limits, VALIDATION_TURNS, tones, arc_s, tones_s)
    return fitting(
        limits, Experiment("validation", voltage_v, 1.0 / limits.sample_rate_hz, 1,
                           f"slow arcs of unseen amplitudes, then tones {_band(tones)}")
    )


def multisine(
    limits: StageLimits = USUAL_LIMITS, arc_s: float = 0.5, tones_s: float = 1.0,
    tones: Sequence[Sequence[float]] = MULTISINE_TONES,
) -> Experiment:
    """Design six tones around mid-range (3.4.2), which excite the modes.

    It climbs from the lowest voltage, where the memory of the hysteresis is known, so that an
    identified Preisach model gives the input of the dynamics.

    Parameters
    ----------
    arc_s, tones_s : float
        Durations of the climb and of the tones.
    tones : sequence of (float, float)
        Frequency (Hz) and amplitude, as a fraction of the voltage range, of each tone; by default
        100 to 600 Hz.
    """
    voltage_v = _arcs_and_tones(limits, MULTISINE_TURNS, tones, arc_s, tones_s)
    return fitting(
        limits, Experiment("multisine", voltage_v, 1.0 / limits.sample_rate_hz, 1,
                           f"{len(tones)} tones {_band(tones)} around mid-range")
    )


def diagnostic(limits: StageLimits = USUAL_LIMITS, repeats: int = 4) -> Experiment:
    """Design a waveform that shows effects a model may lack: rest, loops, rates, steps, tones.

    It begins at the lowest voltage, where the memory of the hysteresis is known. The repeats
    separate noise, drift and the response to the voltage.
    """
    voltage_v = diagnostic_block(limits)
    return fitting(
        limits, Experiment("diagnostic", voltage_v, 1.0 / limits.sample_rate_hz, repeats,
                           "rest, loops, loops ever faster, steps and tones, repeated")
    )


def distortion(
    limits: StageLimits = USUAL_LIMITS, swing: float = 0.25, period_s: float = 1.0,
    periods: int = 8, highest_hz: float = 1000.0,
) -> Experiment:
    """Design odd tones, some omitted, which separate noise, even distortion and odd distortion.

    Parameters
    ----------
    swing : float
        Largest deviation from the middle as a fraction of the voltage range; the slew limit can
        reduce it.
    period_s, highest_hz : float
        Period (the reciprocal of the line spacing) and highest excited frequency.
    periods : int
        Number of periods. The motion settles in the first; the others give the noise.

    Raises
    ------
    ValueError
        If there are fewer than three periods, or the band holds too few lines.
    """
    if periods < 3:
        raise ValueError(f"experiment 'distortion' has {periods} periods: give at least 3, of "
                         "which the first settles and the others show the noise")
    return fitting(
        limits, Experiment("distortion", distortion_period(limits, swing, period_s, highest_hz),
                           1.0 / limits.sample_rate_hz, periods,
                           "odd tones around mid-range, some omitted, repeated"))


EXPERIMENTS = {
    "creep": creep, "dynamics": dynamics, "hysteresis": hysteresis, "validation": validation
}
"""Experiments of the identification sequence, in their order."""

FURTHER_EXPERIMENTS = {"multisine": multisine, "relay": relay, "diagnostic": diagnostic,
                       "distortion": distortion}
"""Experiments that run only on request; `relay` acts in feedback, the others play a waveform."""


GROUP = "piezo_identification.experiments"
"""Entry points through which other packages add experiments: functions of the stage's limits."""


def named_experiment(
    name: str, limits: StageLimits = USUAL_LIMITS, parameters: Mapping[str, Any] | None = None,
) -> Experiment | RelayExperiment:
    """Make the experiment of this name.

    Parameters
    ----------
    parameters : dict of str to object, optional
        Parameters that differ from the defaults.

    Raises
    ------
    ValueError
        If there is no experiment of this name, it exceeds the limits, or that of another package
        cannot be imported or does not return an experiment.

    Examples
    --------
    >>> from piezo_identification import StageLimits
    >>> experiment = named_experiment("creep", StageLimits(voltage_min_v=0.0, voltage_max_v=100.0))
    >>> print(experiment.sample_period_s, experiment.voltage_v.min(), experiment.voltage_v.max())
    0.01 35.0 65.0
    """
    known = registered(GROUP, EXPERIMENTS | FURTHER_EXPERIMENTS)
    if name not in known:
        raise ValueError(f"unknown experiment '{name}': choose one of {', '.join(known)}, "
                         "probe")
    experiment = known[name](limits, **(parameters or {}))
    if isinstance(experiment, RelayExperiment):
        return experiment
    if not isinstance(experiment, Experiment) or experiment.name != name:
        raise ValueError(f"what is registered as the experiment '{name}' makes something else: "
                         "let it return an Experiment of this name")
    return fitting(limits, experiment)


def _square_wave(
    limits: StageLimits, period_s: float, sample_period_s: float, swing_v: float | None,
) -> FloatArray:
    """Return one period (N,) between two levels around the middle, the upper one first."""
    if swing_v is None:
        largest_v = limits.slew_limit_v_per_s / limits.sample_rate_hz
        swing_v = min(SWING_FRACTION * limits.span_v, largest_v)
    half = round(0.5 * period_s / sample_period_s)
    if half < 1:
        raise ValueError(
            f"a square wave of {period_s:g} s has no sample of {sample_period_s:g} s in half a "
            "period: make its period longer, or the sample clock faster")
    levels_v = limits.middle_v + 0.5 * swing_v * np.array([1.0, -1.0])
    return np.repeat(levels_v, half)


def _arcs_and_tones(
    limits: StageLimits, turns: Sequence[float], tones: Sequence[Sequence[float]], arc_s: float,
    tones_s: float,
) -> FloatArray:
    """Return arcs from turn to turn, then tones about the last (N,).

    Turns and amplitudes are fractions of the voltage range.
    """
    highest_hz = max(frequency_hz for frequency_hz, _ in tones)
    if limits.sample_rate_hz <= 2.0 * highest_hz:
        raise ValueError(
            f"tones up to {highest_hz:g} Hz need a sample clock of more than {2 * highest_hz:g} "
            f"Hz, the stage has {limits.sample_rate_hz:g} Hz: choose lower tones or a faster clock")
    samples = round(arc_s * limits.sample_rate_hz)
    arcs = [arc(start, end, samples) for start, end in pairwise(turns)]
    time_s = np.arange(round(tones_s * limits.sample_rate_hz)) * (1.0 / limits.sample_rate_hz)
    waves = turns[-1] + sum(
        amplitude * np.sin(2.0 * np.pi * frequency_hz * time_s)
        for frequency_hz, amplitude in tones
    )
    return limits.voltage_min_v + limits.span_v * np.concatenate([*arcs, waves])


def _band(tones: Sequence[Sequence[float]]) -> str:
    frequencies_hz = [frequency_hz for frequency_hz, _ in tones]
    return f"from {min(frequencies_hz):g} to {max(frequencies_hz):g} Hz"


def fitting(limits: StageLimits, experiment: Experiment) -> Experiment:
    """Return the experiment; raise ValueError if the stage cannot play it unchanged."""
    if experiment.voltage_v.ndim != 1 or not np.isfinite(experiment.voltage_v).all() or (
            experiment.voltage_v.size == 0):
        raise ValueError(f"experiment '{experiment.name}' has no waveform of finite voltages: "
                         "make voltage_v one sequence of them")
    held = experiment.sample_period_s * limits.sample_rate_hz
    if held < 0.5 or abs(held - round(held)) > 1e-6 * held:
        raise ValueError(
            f"experiment '{experiment.name}' holds each value for {experiment.sample_period_s:g} "
            f"s: make it a whole number of samples of {1.0 / limits.sample_rate_hz:g} s")
    lowest_v, highest_v = experiment.voltage_v.min(), experiment.voltage_v.max()
    tolerance_v = 1e-9 * limits.span_v
    if lowest_v < limits.voltage_min_v - tolerance_v or (
        highest_v > limits.voltage_max_v + tolerance_v
    ):
        raise ValueError(
            f"experiment '{experiment.name}' needs {lowest_v:g}..{highest_v:g} V, the stage allows "
            f"{limits.voltage_min_v:g}..{limits.voltage_max_v:g} V: make it smaller"
        )
    # A change of a held value happens within one period of the sample clock.
    steps_v = np.diff(np.append(experiment.voltage_v, experiment.voltage_v[:1])
                      if experiment.repeats > 1 else experiment.voltage_v)
    slew_v_per_s = np.abs(steps_v).max(initial=0.0) * limits.sample_rate_hz
    if slew_v_per_s > limits.slew_limit_v_per_s * (1.0 + 1e-9):
        raise ValueError(
            f"experiment '{experiment.name}' needs a slew of {slew_v_per_s:.3g} V/s, the stage "
            f"allows {limits.slew_limit_v_per_s:.3g} V/s: make its steps smaller"
        )
    return replace(experiment, voltage_v=limits.clip(experiment.voltage_v))
