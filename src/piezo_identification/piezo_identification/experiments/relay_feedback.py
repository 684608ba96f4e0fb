# SPDX-License-Identifier: BSD-3-Clause
"""Relay feedback for the ultimate frequency and gain (thesis 3.3.3 and 3.4.2, Fig. 3.7)."""

from dataclasses import dataclass, field

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.experiments.input_designs import arc
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

AMPLITUDE_FRACTION = 0.05
"""Step of the relay to either side of the working voltage, as a fraction of the voltage range."""

ARC_S, CYCLE_S, HOLD_S = 0.25, 0.2, 0.05
"""Durations of the arcs to the ends of the range, of the slow cycle with the relay's amplitude, and
of the rest before the relay starts."""

NOISE_FACTOR = 4.0
"""Half width of the relay's hysteresis over the noise of the means it compares."""

SETTLING_CYCLES = 5
"""Cycles at the start that are excluded."""

HARMONICS = (1, 3, 5)
"""Harmonics of the oscillation that a relay excites."""


@dataclass(frozen=True)
class RelayExperiment:
    """Slow arcs to the working voltage, and then a relay in feedback."""

    name: str
    """Name that selects the experiment."""
    feedforward_v: FloatArray = field(repr=False)
    """Voltage played at the sample clock before the relay starts, (N,); its last value is then
    held."""
    lowest_sample: int
    """Sample at which the feedforward reaches the lowest voltage."""
    cycle: slice
    """Samples of the slow cycle with the relay's amplitude around the working voltage."""
    amplitude_v: float
    """Amplitude of the relay."""
    samples_per_tick: int
    """Samples that the relay averages, and for which it holds its output."""
    sample_period_s: float
    duration_s: float
    """Period of the sample clock; duration of the experiment."""
    description: str
    """One line for users."""

    @property
    def ticks(self) -> int:
        """Return the number of feedback periods in the experiment."""
        return round(self.duration_s / self.tick_s)

    @property
    def tick_s(self) -> float:
        """Return the feedback period of the stage in s."""
        return self.samples_per_tick * self.sample_period_s

    @property
    def delay_s(self) -> float:
        """Return the declared delay of the loop, from the middle of a mean to that of the hold.

        The output for the mean of a tick acts in the tick after the next.
        """
        return 2.5 * self.tick_s - 0.5 * (self.samples_per_tick - 1) * self.sample_period_s

    def parameters(self) -> dict[str, float]:
        """Return the parameters to store with a recording of the experiment."""
        return {"amplitude_v": self.amplitude_v, "tick_s": self.tick_s, "delay_s": self.delay_s}


def relay(limits: StageLimits, oscillation_s: float = 0.5) -> RelayExperiment:
    """Design a relay around mid-range, preceded by a measurement of the gains of the hysteresis.

    The voltage goes from rest to the lowest value, to the highest one, and down into a slow cycle
    of the relay's amplitude. That shows the gains of the hysteresis (3.16): the secant from the
    lowest voltage, and the gain of the minor loop in which the relay moves.

    Raises
    ------
    ValueError
        If the stage's slew limit does not allow the relay's step.
    """
    amplitude_v, working_v = AMPLITUDE_FRACTION * limits.span_v, limits.middle_v
    if 2.0 * amplitude_v * limits.sample_rate_hz > limits.slew_limit_v_per_s:
        raise ValueError(
            f"experiment 'relay' needs a slew of {2.0 * amplitude_v * limits.sample_rate_hz:.3g} "
            f"V/s, the stage allows {limits.slew_limit_v_per_s:.3g} V/s: leave it out"
        )
    low_v, high_v = working_v - amplitude_v, working_v + amplitude_v
    turns = [
        (limits.rest_voltage_v, 0.0), (limits.voltage_min_v, ARC_S), (limits.voltage_max_v, ARC_S),
        (low_v, ARC_S), (high_v, 0.5 * CYCLE_S), (low_v, 0.5 * CYCLE_S),
        (working_v, 0.25 * CYCLE_S), (working_v, HOLD_S),
    ]
    arcs = [
        arc(start_v, end_v, round(time_s * limits.sample_rate_hz))
        for (start_v, _), (end_v, time_s) in zip(turns[:-1], turns[1:], strict=True)
    ]
    ends = np.cumsum([way_v.size for way_v in arcs])
    duration_s = ends[-1] / limits.sample_rate_hz + oscillation_s
    return RelayExperiment(
        "relay", limits.clip(np.concatenate(arcs)), int(ends[0]),
        slice(int(ends[2]), int(ends[4])), amplitude_v, limits.samples_per_tick,
        1.0 / limits.sample_rate_hz, duration_s,
        f"relay of {amplitude_v:g} V to either side of {working_v:g} V, after the whole range and "
        "a slow cycle of that amplitude",
    )


class RelayRun:
    """Compute the relay's output for each tick of a relay experiment.

    The relay switches when the mean displacement of a tick passes the middle of the slow cycle. Its
    hysteresis keeps noise from switching it.
    """

    def __init__(self, experiment: RelayExperiment) -> None:
        self._experiment = experiment
        self._means_um: list[float] = []
        self._thresholds_um: tuple[float, float] | None = None
        self._answer_v = experiment.amplitude_v

    @property
    def fraction(self) -> float:
        """Return the fraction of the experiment that is done (0 to 1)."""
        return min(1.0, len(self._means_um) / self._experiment.ticks)

    def take(self, displacement_um: FloatArray) -> float:
        """Take the samples of the next tick; return the output, 0 V during the feedforward."""
        experiment = self._experiment
        mean_um = float(np.mean(displacement_um))
        self._means_um.append(mean_um)
        if len(self._means_um) * experiment.samples_per_tick < experiment.feedforward_v.size:
            return 0.0
        if self._thresholds_um is None:
            self._thresholds_um = self._middle_and_half_width_um()
        middle_um, half_width_um = self._thresholds_um
        if abs(mean_um - middle_um) > half_width_um:
            self._answer_v = -float(np.copysign(experiment.amplitude_v, mean_um - middle_um))
        return self._answer_v

    def _middle_and_half_width_um(self) -> tuple[float, float]:
        experiment, means_um = self._experiment, np.array(self._means_um)
        begin, end = (sample // experiment.samples_per_tick
                      for sample in (experiment.cycle.start, experiment.cycle.stop))
        middle_um = float(np.mean(_ends(means_um[begin:end])))
        held = round(HOLD_S / experiment.tick_s)
        # Differences remove the creep.
        noise_um = float(np.std(np.diff(means_um[-held:])) / np.sqrt(2.0))
        return middle_um, NOISE_FACTOR * noise_um


@dataclass(frozen=True)
class RelayOscillation:
    """The oscillation of a relay experiment."""

    frequency_hz: float
    """Frequency of the loop with its delay."""
    shortest_ticks: int
    longest_ticks: int
    """Shortest and longest period in ticks; the relay switches only at whole ticks."""
    harmonics_hz: FloatArray
    """Frequencies of the odd harmonics, (K,)."""
    response_um_per_v: ComplexArray
    """Frequency response of the stage alone at the harmonics, (K,)."""
    loop_gain_v_per_um: float
    """Ultimate gain at this amplitude, at which the loop just oscillates."""
    cycle_gain_um_per_v: float
    """Gain of the hysteresis in the slow cycle of the same amplitude."""
    largest_gain_um_per_v: float
    """Largest secant gain of the hysteresis from the lowest voltage (3.16), over the voltages of
    the cycle."""
    delay_s: float
    tick_s: float
    """Declared delay and feedback period of the loop."""

    @property
    def gain_margin(self) -> float:
        """Return the gain margin g_m (3.18) of the dynamics without hysteresis.

        It is the ultimate gain of the loop times the gain of the hysteresis in the slow cycle.
        """
        return self.loop_gain_v_per_um * self.cycle_gain_um_per_v

    @property
    def ultimate_gain_v_per_um(self) -> float:
        """Return the ultimate gain k_u (3.19), g_m over the largest gain of the hysteresis."""
        return self.gain_margin / self.largest_gain_um_per_v

    @property
    def summary(self) -> str:
        """Return the results as text, including the PI controller (3.20)."""
        gain, part = 0.6 * self.ultimate_gain_v_per_um, self.tick_s * self.frequency_hz
        ticks = " to ".join(str(n) for n in sorted({self.shortest_ticks, self.longest_ticks}))
        phases_deg = np.degrees(np.unwrap(np.angle(self.response_um_per_v)))
        stage = ", ".join(
            f"{abs(response):.3g} um/V at {phase:.0f} degrees at {frequency:.4g} Hz"
            for frequency, response, phase in zip(
                self.harmonics_hz, self.response_um_per_v, phases_deg, strict=True))
        return "\n".join([
            f"The loop with its declared delay of {1e3 * self.delay_s:.3g} ms oscillates at "
            f"{self.frequency_hz:.4g} Hz, in periods of {ticks} ticks of {1e3 * self.tick_s:g} ms.",
            f"The stage alone: {stage}.",
            f"Ultimate gain of this loop {self.loop_gain_v_per_um:.3g} V/um where the hysteresis "
            f"gives {self.cycle_gain_um_per_v:.3g} um/V; for the largest it may give, "
            f"{self.largest_gain_um_per_v:.3g} um/V (3.16), k_u {self.ultimate_gain_v_per_um:.3g} "
            f"V/um (3.19).",
            f"PI controller (3.20): ({gain * (1.0 + part):.4g} z - {gain * (1.0 - part):.4g}) / "
            "(z - 1) V/um.",
        ])


def relay_oscillation(recording: Recording, experiment: RelayExperiment) -> RelayOscillation:
    """Evaluate the recording of a relay experiment.

    Raises
    ------
    ValueError
        If samples are missing, or the stage did not oscillate steadily.
    """
    part = recording.select(recording.tracking)
    if part.gaps:
        raise ValueError(f"{recording.path} has gaps: record it again")
    voltage_v, displacement_um = part.voltage_v, part.displacement_um
    held = part.has(Flag.FEEDFORWARD_HELD)
    # The relay does not act yet in the first tick after the feedforward.
    begin = int(np.flatnonzero(held)[0]) + 2 * experiment.samples_per_tick if held.any() else 0
    switched = np.flatnonzero(np.diff(voltage_v[begin:]) > experiment.amplitude_v) + 1 + begin
    rises = switched[SETTLING_CYCLES:]
    if rises.size < 3 or not held.any():
        raise ValueError(
            f"{recording.path} does not oscillate for {SETTLING_CYCLES + 3} cycles: the loop is "
            "slower than expected, record longer"
        )
    periods = np.diff(rises)
    if np.ptp(periods) > 0.5 * np.median(periods):
        raise ValueError(
            f"{recording.path} does not oscillate steadily, its periods go from {periods.min()} to "
            f"{periods.max()} samples: use a larger step of the relay"
        )
    whole = slice(rises[0], rises[-1])
    period_s = periods.mean() * experiment.sample_period_s
    harmonics_hz = np.array(HARMONICS) / period_s
    lines_v, lines_um = (
        _lines(signal[whole], harmonics_hz * experiment.sample_period_s)
        for signal in (voltage_v, displacement_um)
    )
    # A voltage that is held for a sample acts half a sample late.
    held_back = np.exp(1j * np.pi * harmonics_hz * experiment.sample_period_s)
    # The mean over a tick and the hold for a tick attenuate by the same factor.
    attenuation = np.sinc(harmonics_hz[0] * experiment.tick_s) ** 2
    cycle_v, cycle_um = (
        np.subtract(*_ends(signal[experiment.cycle])) for signal in (voltage_v, displacement_um)
    )
    return RelayOscillation(
        1.0 / period_s,
        round(periods.min() / experiment.samples_per_tick),
        round(periods.max() / experiment.samples_per_tick),
        harmonics_hz, lines_um / lines_v * held_back,
        float(abs(lines_v[0]) / abs(lines_um[0]) / attenuation),
        float(cycle_um / cycle_v),
        _largest_secant(voltage_v, displacement_um, experiment),
        experiment.delay_s, experiment.tick_s,
    )


def _ends(cycle: FloatArray) -> tuple[float, float]:
    """Return the signal at the top and bottom of the slow cycle, which begins at the bottom."""
    # Average around the turns, where voltage and displacement hardly change.
    near = max(1, cycle.size // 40)
    middle = cycle.size // 2
    return cycle[middle - near : middle + near].mean(), cycle[-near:].mean()


def _largest_secant(
    voltage_v: FloatArray, displacement_um: FloatArray, experiment: RelayExperiment,
) -> float:
    """Return the largest secant gain from the lowest voltage on the descent to the cycle (3.16)."""
    lowest = experiment.lowest_sample
    # The mean over a tick reduces the noise of the end that all secants share.
    origin_um = displacement_um[lowest - experiment.samples_per_tick : lowest].mean()
    high_v = voltage_v[experiment.cycle].max()
    down = np.arange(lowest, experiment.cycle.start)
    down = down[down > np.argmax(voltage_v[: experiment.cycle.start])]
    down = down[voltage_v[down] <= high_v]
    travel_v = voltage_v[down] - voltage_v[lowest]
    return float(np.max((displacement_um[down] - origin_um) / travel_v))


def _lines(signal: FloatArray, cycles_per_sample: FloatArray) -> ComplexArray:
    """Return complex amplitudes at some frequencies, fitted with offset, drift and even lines."""
    samples = np.arange(signal.size)
    even = 2.0 * cycles_per_sample[0] * np.arange(1, 4)
    waves = np.exp(2j * np.pi * np.outer(samples, np.concatenate([cycles_per_sample, even])))
    basis = np.column_stack([np.ones(signal.size), samples / signal.size, waves.real, waves.imag])
    coefficients = np.linalg.lstsq(basis, signal, rcond=None)[0]
    count, total = cycles_per_sample.size, waves.shape[1]
    return coefficients[2 : 2 + count] - 1j * coefficients[2 + total : 2 + total + count]
