# SPDX-License-Identifier: BSD-3-Clause
"""Voltage that makes the model of a stage follow a periodic reference (thesis 5.2.2)."""

from dataclasses import dataclass, field, replace

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.approach import (
    FADE_S,
    RAMP_S,
    USUAL_STAGE,
    StageClock,
    aligned_samples,
    check_amplifier_range,
)
from piezo_controller.feedforward.feasibility import (
    VOLTAGE,
    Infeasible,
    check_hysteresis_range,
    check_range,
    check_slew,
    unreachable,
)
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.references.kind import Watch
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import continue_linear, simulate_linear, zoh
from piezo_models.linear.periodic_inversion import invert_linear_periodic

MODES = ("open_loop", "feedforward")

SETTLE_S = 0.1
# Above this the stage responds too little for an inverse. The reference's content there is omitted
# if that costs less than `NEGLIGIBLE_PART` (rms) of its travel.
BANDWIDTH_HZ = 2500.0
NEGLIGIBLE_PART = 0.01
# Lower cut-offs of what the compensation adds at reversals, tried when it demands too much voltage.
COMPENSATION_BANDWIDTHS_HZ = BANDWIDTH_HZ, 1200.0, 600.0, 300.0
NEGLIGIBLE_CONTENT = 1e-3
CORRECTIONS = 2


@dataclass(frozen=True, eq=False)
class FeedforwardPlan(TrackingPlan):
    """Voltage to play and displacement to expect, sample by sample.

    The first voltages and displacements, (n,), are those from the start voltage down to the model's
    lowest voltage, which erases the memory of the hysteresis, then up to the reference's centre,
    with the reference faded in. The periods, (m,), are repeated after that, from `begin_sample` on.
    Effects that are not compensated have causes outside the stage.
    """

    once_voltage_v: FloatArray
    period_voltage_v: FloatArray
    reference_once_um: FloatArray
    reference_period_um: FloatArray
    feedback_start_sample: int
    uncompensated: tuple[str, ...] = ()
    begin_sample: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "begin_sample", len(self.once_voltage_v))

    def voltage_v(self, first_sample: int, count: int) -> FloatArray:
        """Return the voltages of `count` samples from `first_sample` on (V)."""
        return _play(self.once_voltage_v, self.period_voltage_v, first_sample, count)

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of `count` samples from `first_sample` on (um)."""
        return _play(self.reference_once_um, self.reference_period_um, first_sample, count)

    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um)."""
        return float(np.ptp(self.reference_period_um[:samples]))


def plan_feedforward(reference_um: ArrayLike, model: StageModel, mode: str = "feedforward", *,
                     stage: StageClock = USUAL_STAGE, duration_s: float = 1.0,
                     watch: Watch | None = None) -> FeedforwardPlan:
    """Plan the voltage that makes a model at rest follow a periodic reference.

    The linear dynamics are inverted harmonic by harmonic on the sampled model (4.22), the
    hysteresis exactly and with its memory. Creep continues throughout a run: the mean is chosen
    such that the displacement has the reference's mean over `duration_s`, the duration of the
    periodic part (s). Further effects of the model are compensated where they act, so that the
    measured displacement follows the reference.

    The reference, (m,), is one period of the displacement. The mode is ``feedforward``; or
    ``open_loop``, which uses only the gain over the whole range and the mean, and compensates
    nothing.

    Raise UnreachableReference, which names what is reachable, if the voltage would leave the range
    or exceed the slew limit, and ValueError if the model's range does not fit the amplifier's, or
    the mode is unknown.
    """
    reference_um = np.asarray(reference_um, dtype=float)
    planner = FeedforwardPlanner(len(reference_um), model, mode, stage=stage, duration_s=duration_s)
    try:
        return planner.plan(reference_um)
    except Infeasible as reason:
        def scaled(centre_um: float, scale: float) -> FeedforwardPlan:
            return planner.plan(centre_um + scale * (reference_um - centre_um))

        raise unreachable(scaled, reference_um, planner.hysteresis.output_range_um, reason,
                          watch) from None


class FeedforwardPlanner:
    """Plans references of one period length (samples) for one model; see `plan_feedforward`."""

    def __init__(self, period: int, model: StageModel, mode: str = "feedforward", *,
                 stage: StageClock = USUAL_STAGE, duration_s: float = 1.0) -> None:
        if mode not in MODES:
            raise ValueError(
                f'unknown mode {mode!r} of the feedforward: use one of {", ".join(MODES)}')
        check_amplifier_range(model.hysteresis, stage)
        self.model = replace(model, effects=tuple(
            effect for effect in model.effects if effect.follows_voltage))
        self.uncompensated = tuple(
            effect.name for effect in model.effects if not effect.follows_voltage)
        self.hysteresis = model.hysteresis
        self.period = period
        self.mode = mode
        self.stage = stage
        self.sample_period_s = sample_period_s = stage.sample_period_s
        self.linear = model.linear()
        self.sampled = zoh(self.linear, sample_period_s)

        ramp, fade = self._aligned(RAMP_S), self._aligned(FADE_S)
        # The hysteresis is periodic after one whole period.
        settle = self._aligned(max(SETTLE_S, period * sample_period_s))
        self.ramp = minimum_jerk(ramp)
        self.fade_start = 2 * ramp
        self.once = self.fade_start + fade + settle
        self.fade = np.r_[minimum_jerk(fade), np.ones(settle + period)]
        self.fade_phase = np.arange(self.fade_start - self.once, period) % period

        rest = model.memory(stage.rest_voltage_v)
        self.rest_memory = rest.hysteresis
        self.rest_hysteresis_um = rest.hysteresis.hysteresis_um
        self.rest_displacement_um = float(self.sampled.C[0] @ rest.linear_state)
        self.periods = max(round(duration_s / (period * sample_period_s)), 1)
        self.gain_um_per_v = self.hysteresis.mean_gain_um_per_v

    def _aligned(self, time_s: float) -> int:
        return aligned_samples(time_s, self.sample_period_s)

    def plan(self, reference_um: FloatArray,
             correction_um: FloatArray | float = 0.0) -> FeedforwardPlan:
        """Plan one reference; raise `Infeasible` if that is impossible.

        A correction is added to the played reference, but not to the expected displacement.
        """
        for target_um in self._behind_linear(reference_um):
            try:
                return self._plan_target(target_um + correction_um, reference_um)
            except Infeasible as error:
                reason = error
        raise reason

    def _plan_target(self, target_um: FloatArray, reference_um: FloatArray) -> FeedforwardPlan:
        """Return the plan for which the output of the linear part is the target."""
        mean_um = target_um.mean()
        wave = self._wave(target_um - mean_um, bandwidth_hz(reference_um, self.sample_period_s))
        level, level_gain = mean_um, self._mean_over_run_um(
            np.arange(self.once + self.period) >= self.fade_start)
        if self.mode == "open_loop":
            level = self.hysteresis.voltage_min_v + (
                mean_um - self.hysteresis.output_range_um[0]) / self.gain_um_per_v
            level_gain *= self.gain_um_per_v
        for _ in range(CORRECTIONS):
            _, hysteresis_um = self._play(level, wave)
            level += (mean_um - self._mean_displacement_um(hysteresis_um)) / level_gain
        voltage_v, hysteresis_um = self._play(level, wave)
        check_slew(np.append(voltage_v, voltage_v[self.once]), self.sample_period_s,
                   self.stage.slew_limit_v_per_s)
        return FeedforwardPlan(voltage_v[:self.once], voltage_v[self.once:],
                               self._expected_once_um(hysteresis_um, reference_um),
                               reference_um.copy(), self.fade_start, self.uncompensated)

    def _behind_linear(self, reference_um: FloatArray) -> list[FloatArray]:
        """Return candidate periods of the linear part's output for which the sensor measures it.

        The best comes first; the others need less of the amplifier.
        """
        effects = self.model.effects_at("displacement") + self.model.effects_at("sensor")
        if self.mode == "open_loop" or not effects:
            return [reference_um]
        added_um = np.fft.rfft(
            self._compensated(reference_um, ("sensor", "displacement")) - reference_um)
        content = np.abs(np.fft.rfft(reference_um - reference_um.mean()))
        frequency_hz = np.fft.rfftfreq(self.period, self.sample_period_s)
        highest_hz = frequency_hz[content >= NEGLIGIBLE_CONTENT * content.max()][-1]
        return [reference_um + np.fft.irfft(np.where(frequency_hz <= cut_hz, added_um, 0.0),
                                            self.period)
                for cut_hz in COMPENSATION_BANDWIDTHS_HZ
                if cut_hz >= min(highest_hz, BANDWIDTH_HZ)]

    def _compensated(self, wanted: FloatArray, places: tuple[str, ...]) -> FloatArray:
        """Return the period before the effects at some places, given the one after them."""
        for effect in (effect for place in places
                       for effect in reversed(self.model.effects_at(place))):
            try:
                wanted = effect.compensate(wanted, self.sample_period_s)
            except ValueError as error:
                raise Infeasible(str(error)) from None
        return wanted

    def _wave(self, alternating_um: FloatArray, highest_hz: float) -> FloatArray:
        """Return a period of the input without its mean: in um, or in V for open loop."""
        if self.mode == "open_loop":
            return alternating_um / self.gain_um_per_v
        harmonics = np.fft.rfft(alternating_um)
        frequency_hz = np.fft.rfftfreq(self.period, self.sample_period_s)
        harmonics[(frequency_hz > highest_hz) | (frequency_hz == 0)] = 0
        within_um = np.fft.irfft(harmonics, self.period)
        return invert_linear_periodic(within_um, self.linear, self.sample_period_s)

    def _play(self, level: float, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return voltage and hysteresis output of the part played once and of one period."""
        lowest_v, highest_v = self.hysteresis.voltage_min_v, self.stage.voltage_range_v[1]
        start_v = self.stage.rest_voltage_v
        target = level + self.fade * wave[self.fade_phase]
        if self.mode == "open_loop":
            check_range(target, lowest_v, highest_v, VOLTAGE)
            centre_v = level
        else:
            check_hysteresis_range(target, self.hysteresis)
            centre_v = self.hysteresis.invert([level])[0]
        voltage_v = np.r_[start_v + (lowest_v - start_v) * self.ramp,
                          lowest_v + (centre_v - lowest_v) * self.ramp]
        memory = self.rest_memory.copy()
        hysteresis_um = self.hysteresis.simulate(
            self.model.amplified(voltage_v, self.sample_period_s), memory)
        if self.mode == "open_loop":
            played_v, played_um = target, self.hysteresis.simulate(target, memory)
        else:
            played_v, played_um = self.hysteresis.invert(target, memory), target
            period_v = played_v[-self.period:]
            ahead_v = self._compensated(period_v, ("voltage",)) - period_v
            played_v = played_v + self.fade * ahead_v[self.fade_phase]
        check_range(played_v, lowest_v, highest_v, VOLTAGE)
        return np.r_[voltage_v, played_v], np.r_[hysteresis_um, played_um]

    def _mean_displacement_um(self, hysteresis_um: FloatArray) -> float:
        """Return the mean displacement of the model over the run, after the once part."""
        return self.rest_displacement_um + self._mean_over_run_um(
            hysteresis_um - self.rest_hysteresis_um)

    def _mean_over_run_um(self, deviation_um: ArrayLike) -> float:
        """Return the mean deviation of the displacement over the repeated part."""
        deviation_um = np.asarray(deviation_um, dtype=float)
        return mean_over_repeats(self.sampled, deviation_um[:self.once],
                                 deviation_um[self.once:], self.periods)

    def _expected_once_um(self, hysteresis_um: FloatArray, reference_um: FloatArray) -> FloatArray:
        """Return the modelled measurement of the part played once, blended into the reference."""
        deviation_um = hysteresis_um[:self.once] - self.rest_hysteresis_um
        expected_um = self.model.sensed(
            self.rest_displacement_um + simulate_linear(self.sampled, deviation_um),
            self.sample_period_s)
        creep_um = reference_um.mean() - expected_um[-self.period:].mean()
        lead = self.fade[:self.once - self.fade_start]
        expected_um[self.fade_start:] += lead * creep_um
        return expected_um


def bandwidth_hz(reference_um: FloatArray, sample_period_s: float) -> float:
    """Return the highest frequency of a period that has to be inverted (Hz).

    It is `BANDWIDTH_HZ`, or more if the content above it exceeds `NEGLIGIBLE_PART`.
    """
    harmonics_um = np.abs(np.fft.rfft(reference_um)) / reference_um.size
    harmonics_um[1:(reference_um.size + 1) // 2] *= np.sqrt(2)  # those that have a conjugate
    above_um = np.sqrt(np.cumsum(harmonics_um[::-1] ** 2)[::-1])  # by Parseval
    frequency_hz = np.fft.rfftfreq(reference_um.size, sample_period_s)
    # Rounding errors do not count, as for a constant reference.
    allowed_um = max(NEGLIGIBLE_PART * np.ptp(reference_um), 1e-9 * np.abs(reference_um).max())
    needed_hz = frequency_hz[1:][above_um[1:] > allowed_um]
    return max(BANDWIDTH_HZ, needed_hz.max(initial=0.0))


def _play(once: FloatArray, period: FloatArray, first: int, count: int) -> FloatArray:
    sample = np.arange(first, first + count)
    repeated = period[(sample - len(once)) % len(period)]
    return np.where(sample < len(once), once[np.minimum(sample, len(once) - 1)], repeated)


def mean_over_repeats(system: control.StateSpace, once: np.ndarray, period: np.ndarray,
                      repeats: int) -> float:
    """Return the mean output while an input is repeated, after another input is played once.

    The state at the beginning of a period and the sum of the outputs so far follow from those of
    the previous period by an affine map; a power of its matrix covers all periods. The system is
    discrete, with one input and one output, and all its states are initially zero.
    """
    n = system.nstates
    _, first_state = continue_linear(system, once, np.zeros(n))
    output, driven = continue_linear(system, period, np.zeros(n))
    # Map from the state at a period's beginning to that at its end and to the sum of its outputs.
    free = np.linalg.matrix_power(
        np.block([[system.A, np.zeros((n, 1))], [system.C, np.ones((1, 1))]]), len(period))
    step = np.zeros((n + 2, n + 2))
    step[:n, :n], step[:n, n] = free[:n, :n], driven
    step[n, n] = step[n + 1, n + 1] = 1.0
    step[n + 1, :n], step[n + 1, n] = free[n, :n], output.sum()
    end = np.linalg.matrix_power(step, repeats) @ np.r_[first_state, 1.0, 0.0]
    return float(end[-1] / (repeats * len(period)))
