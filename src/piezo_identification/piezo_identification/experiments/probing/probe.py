# SPDX-License-Identifier: BSD-3-Clause
"""Measure a stage of which only the limits are known, step by step."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import played
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.probing.findings import (
    SENSOR_MARGIN,
    Creep,
    Findings,
    Pulse,
    Rest,
    measure_creep,
    measure_pulse,
    measure_response,
    measure_rest,
)
from piezo_identification.experiments.probing.step_response import StepResponse
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_recorder.reading.recording import Recording

NAME = "probe"
"""Name that selects the probe, in addition to those of the experiments."""

SIGNAL_TO_NOISE = 200.0
"""Wanted height of a step over the RMS noise of one sample; steps grow until they reach it."""

LEAST_SIGNAL_TO_NOISE = 10.0
"""Smallest signal-to-noise ratio with which the gain can be measured."""

SMALLEST_STEP, LARGEST_STEP = 1e-3, 0.3
"""First and largest step as fractions of the voltage range. The other experiments use steps as
large as the largest."""

GROWTH = 2.0
"""Largest ratio of a step to the one before it."""

GAIN_GROWTH = 2.0
"""Bound of the gain growth from step to step: the displacement of a loop grows with the square."""

REST_S, FIRST_DWELL_S, LONGEST_DWELL_S = 0.5, 0.1, 6.4
"""Time at rest to measure the noise; time for which a step is held, longer if it has not
settled."""

SETTLED = 0.1
"""A step has settled if it changes by less than this fraction in the last quarter of the dwell;
creep stays below it."""

AVERAGED_PULSES = 12
"""Pulses that are averaged to show the ringing. One more before them is discarded, as its loop is
not closed."""

FIRST_HOLD_S, LONGEST_HOLD_S, HOLD_GROWTH = 4.0, 1024.0, 4.0
"""First and longest hold for the creep, and their ratio; holds grow until the creep fades."""

HOLD_SAMPLES, LEAD = 800, 20
"""Means in a hold and in the rest before it; none is longer than the stage allows (1 s)."""

Course = Generator[Experiment, Recording, Findings]


@dataclass(frozen=True)
class Step:
    """A step that is large enough to measure and safe for the stage."""

    size_v: float
    """Signed height."""
    dwell: int
    """Samples for which it is held to settle."""
    gain_um_per_v: float
    """Gain of the first rise."""
    signal_to_noise: float
    """Height of the response over the noise of one sample."""


class Probe:
    """Measure a stage by small steps, each chosen from the results of those before it.

    Every step begins and ends at the rest voltage. `step` is the experiment to be played next, and
    None once the probe is complete. `longest_s` is the duration of the longest possible step, which
    indicates the remaining time.
    """

    longest_s = LONGEST_HOLD_S

    def __init__(self, limits: StageLimits) -> None:
        self._course = _course(limits)
        self.step: Experiment | None = next(self._course)
        self._findings: Findings | None = None

    @property
    def findings(self) -> Findings:
        """The results; RuntimeError before the last step was taken."""
        if self._findings is None:
            raise RuntimeError("steps of the probe remain: play them first")
        return self._findings

    def take(self, recording: Recording) -> None:
        """Evaluate the recording of the present step, and choose the next.

        Raise ValueError if samples are missing, the sensor does not follow the voltage, or its
        reading at rest is outside its range.
        """
        try:
            self.step = self._course.send(recording)
        except StopIteration as end:
            self.step, self._findings = None, end.value


def _course(limits: StageLimits) -> Course:
    rest = measure_rest(_measured((yield _silence(limits))))
    _check_rest(rest, limits)
    rest, step = yield from _grow(limits, rest)
    response = yield from _ring(limits, rest, step)
    creep = yield from _creep(limits, rest, step, response.settling_s)
    return Findings(rest, step.size_v, step.gain_um_per_v, step.signal_to_noise, response, creep)


def _grow(limits: StageLimits,
          rest: Rest) -> Generator[Experiment, Recording, tuple[Rest, Step]]:
    """Enlarge a pulse until it exceeds the noise clearly or reaches a limit."""
    upwards = limits.voltage_max_v - limits.rest_voltage_v
    downwards = limits.rest_voltage_v - limits.voltage_min_v
    sign, room_v = (1.0, upwards) if upwards >= downwards else (-1.0, downwards)
    largest_v = min(room_v, LARGEST_STEP * limits.span_v)
    size_v, dwell = SMALLEST_STEP * limits.span_v, round(FIRST_DWELL_S * limits.sample_rate_hz)
    while True:
        voltage_v, rises = _pulses(limits, sign * size_v, dwell, 1)
        measured_um = _measured((yield _experiment(
            limits, "pulse", voltage_v, f"pulse of {sign * size_v:g} V from rest")))
        rest = rest.seen_moving(measured_um)
        pulse = measure_pulse(measured_um, rises[0], rises[0] + dwell, rest.noise_rms_um)
        ratio = abs(pulse.fall_um) / rest.noise_rms_um
        if (ratio > LEAST_SIGNAL_TO_NOISE and pulse.unsettled > SETTLED
                and dwell < LONGEST_DWELL_S * limits.sample_rate_hz):
            dwell *= 4
            continue
        next_v = min(largest_v, size_v * _growth(pulse, ratio, rest, limits))
        if ratio >= SIGNAL_TO_NOISE or next_v <= 1.01 * size_v:
            break
        size_v = next_v
    if ratio < LEAST_SIGNAL_TO_NOISE:
        raise ValueError(
            f"a pulse of {sign * size_v:.3g} V moves the sensor by {abs(pulse.fall_um):.3g} um at "
            f"a noise of {rest.noise_rms_um:.3g} um RMS, and a larger one is not safe: look at "
            "the amplifier, the wiring and the limits of the sensor")
    return rest, Step(sign * size_v, dwell, pulse.rise_um / (sign * size_v), ratio)


def _growth(pulse: Pulse, ratio: float, rest: Rest, limits: StageLimits) -> float:
    """Return the factor by which the next pulse may grow, from noise and sensor range."""
    wanted = GROWTH
    if ratio > LEAST_SIGNAL_TO_NOISE:
        wanted = min(GROWTH, 1.1 * SIGNAL_TO_NOISE / ratio)
    margin_um = SENSOR_MARGIN * limits.displacement_span_um
    for excursion_um, room_um in (
            (pulse.highest_um, limits.displacement_max_um - margin_um - rest.level_um),
            (pulse.lowest_um, rest.level_um - limits.displacement_min_um - margin_um)):
        if excursion_um > 0.0:
            wanted = min(wanted, room_um / (GAIN_GROWTH * excursion_um))
    return wanted


def _ring(limits: StageLimits, rest: Rest,
          step: Step) -> Generator[Experiment, Recording, StepResponse]:
    """Repeat the pulse and decompose the mean response; hold it longer if it still rings."""
    dwell = step.dwell
    while True:
        voltage_v, rises = _pulses(limits, step.size_v, dwell, AVERAGED_PULSES + 1)
        measured_um = _measured((yield _experiment(
            limits, "ringing", voltage_v, f"{AVERAGED_PULSES + 1} pulses of {step.size_v:g} V")))
        response = measure_response(
            measured_um, rises[1:], dwell, rest, 1.0 / limits.sample_rate_hz)
        if (3.0 * response.settling_s * limits.sample_rate_hz <= dwell
                or dwell >= LONGEST_DWELL_S * limits.sample_rate_hz):
            return response
        dwell *= 4


def _creep(limits: StageLimits, rest: Rest, step: Step,
           settling_s: float) -> Generator[Experiment, Recording, Creep]:
    """Hold the step for increasing times until its creep fades."""
    hold_s, steps_s = max(FIRST_HOLD_S, 100.0 * settling_s), np.empty(0)
    while True:
        held = max(1, round(min(hold_s / HOLD_SAMPLES, 1.0) * limits.sample_rate_hz))
        period_s = held / limits.sample_rate_hz
        count = round(hold_s / period_s)
        voltage_v = limits.rest_voltage_v + np.concatenate([
            np.zeros(LEAD), np.full(count, step.size_v), np.zeros(1)])
        recording = yield Experiment(
            "creeping", _with_slow_edges(limits, voltage_v), period_s, 1,
            f"step of {step.size_v:g} V for {hold_s:g} s")
        # A sample is the mean over its period.
        begin_s = float(played(recording).sample_index[0]) / limits.sample_rate_hz
        up_s, down_s = begin_s + LEAD * period_s, begin_s + (LEAD + count) * period_s
        time_s: FloatArray = (np.arange(LEAD + count, dtype=np.float64) + 0.5 - LEAD) * period_s
        # Exclude the fast motion after the step.
        used = (time_s < 0.0) | (time_s > 3.0 * settling_s)
        creep = measure_creep(
            time_s[used], _measured(recording)[:LEAD + count][used],
            np.append(steps_s, up_s) - up_s, rest.of_mean_um(held))
        if creep.ended or hold_s >= LONGEST_HOLD_S:
            return creep
        steps_s = np.append(steps_s, [up_s, down_s])
        hold_s = min(hold_s * HOLD_GROWTH, LONGEST_HOLD_S)


def _silence(limits: StageLimits) -> Experiment:
    samples = round(REST_S * limits.sample_rate_hz)
    return _experiment(limits, "rest", np.full(samples, limits.rest_voltage_v), "rest")


def _pulses(limits: StageLimits, size_v: float, dwell: int,
            count: int) -> tuple[FloatArray, list[int]]:
    """Return equal pulses from rest (N,), and the samples at which they rise."""
    pulse = np.repeat([size_v, 0.0], dwell)
    voltage_v = limits.rest_voltage_v + np.concatenate([np.zeros(dwell), np.tile(pulse, count)])
    return _with_slow_edges(limits, voltage_v), [dwell * (1 + 2 * n) for n in range(count)]


def _with_slow_edges(limits: StageLimits, voltage_v: FloatArray) -> FloatArray:
    """Return the voltage with its slew rate limited to that of the stage."""
    largest_v = (1.0 - 1e-9) * limits.slew_limit_v_per_s / limits.sample_rate_hz
    slewed_v, present_v = voltage_v.copy(), voltage_v[0]
    for n in range(voltage_v.size) if np.abs(np.diff(voltage_v)).max() > largest_v else ():
        present_v += np.clip(voltage_v[n] - present_v, -largest_v, largest_v)
        slewed_v[n] = present_v
    return slewed_v


def _experiment(limits: StageLimits, name: str, voltage_v: FloatArray,
                description: str) -> Experiment:
    return Experiment(name, limits.clip(voltage_v), 1.0 / limits.sample_rate_hz, 1, description)


def _measured(recording: Recording) -> FloatArray:
    """Return the displacement (N,) during the step."""
    return np.asarray(played(recording).displacement_um, dtype=np.float64)


def _check_rest(rest: Rest, limits: StageLimits) -> None:
    if not limits.displacement_min_um < rest.level_um < limits.displacement_max_um:
        raise ValueError(
            f"the sensor reads {rest.level_um:.4g} um at rest, the stage allows "
            f"{limits.displacement_min_um:g}..{limits.displacement_max_um:g} um: correct "
            "minimum_displacement_um and maximum_displacement_um of the stage, or the sensor")
