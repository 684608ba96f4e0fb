# SPDX-License-Identifier: BSD-3-Clause
"""Controllers of fixed order, tuned over all stages at once: the multi-model minimax problem.

The loops of all stages and their derivatives have a closed form at every frequency, so that
`minimax` finds in a second what a direct search does not find in minutes. It is restarted from
changed parameters, as the problem has many local minima.
"""

from dataclasses import dataclass
from itertools import cycle

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.loop_measures import BAND_EDGE
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fixed_order import FixedOrder
from piezo_controller.feedback.sample_rate.minimax import Linearised, lower_largest
from piezo_controller.feedback.sample_rate.perturbed_loops import PerturbedLoops, light_mode
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_models.cascade import StageModel

NEAR_DB = 4.0
"""Distance below the allowed peak from which on a frequency is omitted; no step spans it."""

OUT_OF_REACH_DB = 8.0
"""Distance below the largest value from which on a requirement is omitted."""

NOISE_SHARE = 0.995
"""Part of the allowed noise that the tuning uses, as its sum is less exact than `LoopFigures`."""

STEPS, FEW_STEPS = 150, 40
STARTS = 30
SIZES, SHARES = (0.02, 0.06, 0.15), (0.2, 0.5, 1.0)
"""Sizes of the changes at a restart, and the parts of the parameters that are changed."""

PROMISING = 0.3

UNSEEN_DB = 0.1
"""Allowed excess of a peak between the frequencies of the tuning."""

DECIBELS = 20 / np.log(10)


class LoopProblem:
    """Requirements and bounds of all loops (dB), with derivatives by controller parameters."""

    def __init__(self, loops: PerturbedLoops, demands: Demands, structure: FixedOrder,
                 first_mode_hz: float, gain_um_per_v: float) -> None:
        self._loops, self._demands, self._structure = loops, demands, structure
        self._gain_um_per_v = gain_um_per_v
        period_s = loops.plants[0].dt
        self._points = 2 / period_s * (loops.points - 1) / (loops.points + 1)
        hz = loops.frequency_hz
        # Part of the white noise that belongs to each frequency.
        edges = np.concatenate([[0.0], (hz[1:] + hz[:-1]) / 2, hz[-1:]])
        self._parts = np.diff(edges) / hz[-1]
        self._bandwidth_hz = demands.bandwidth_ratio * first_mode_hz
        self._beyond_db = DECIBELS * np.log(hz / self._bandwidth_hz)
        self._reached = len(loops.plants) if demands.of_every_stage else 1

    def linearise(self, numbers: FloatArray) -> Linearised:
        """Return the negative margins to the requirements, and the bounds, for given parameters."""
        controller, slopes = self._structure.response(numbers, self._points)
        controller = controller / self._gain_um_per_v
        loop = self._loops.responses * controller
        sensitivity = 1 / (1 + loop)
        values, value_slopes = self._margins(loop, sensitivity, slopes)
        bounds, bound_slopes = self._bounds(controller, loop, sensitivity, slopes)
        return Linearised(values, value_slopes, bounds, bound_slopes, _stable(loop))

    def _margins(self, loop: ComplexArray, sensitivity: ComplexArray,
                 slopes: ComplexArray) -> tuple[FloatArray, FloatArray]:
        values, found = [], []
        for one, inverse in zip(loop[:self._reached], sensitivity, strict=False):
            missing_db, missing_slopes = self._missing_bandwidth(one, inverse, slopes)
            values.append(missing_db)
            found.append(missing_slopes)
            for band, asked_db in zip(self._loops.disturbances, self._demands.attenuation_db,
                                      strict=True):
                values.append(asked_db + DECIBELS * np.log(np.abs(inverse[band])))
                found.append(-DECIBELS * np.real(one * inverse * slopes)[:, band])
        return np.concatenate(values), np.concatenate(found, axis=1).T

    def _missing_bandwidth(self, loop: ComplexArray, sensitivity: ComplexArray,
                           slopes: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much (dB) a loop misses the bandwidth, at its frequencies and its end."""
        missing_db = DECIBELS * np.log(BAND_EDGE / np.abs(loop * sensitivity))
        end = int((missing_db > 0.0).argmax())
        reached = end > 0 and self._beyond_db[end - 1] > 0.0
        counts = (self._beyond_db <= 0.0) | reached & (np.arange(missing_db.size) < end)
        counts &= missing_db > -OUT_OF_REACH_DB
        values = missing_db[counts] - np.maximum(self._beyond_db[counts], 0.0)
        found = -DECIBELS * np.real(sensitivity * slopes)
        if not reached:
            return values, found[:, counts]
        before, after = missing_db[end - 1:end + 1]
        rise_db = self._beyond_db[end] - self._beyond_db[end - 1]
        crossed_db = self._beyond_db[end - 1] - before / (after - before) * rise_db
        return (np.append(values, -crossed_db),
                np.column_stack([found[:, counts], rise_db / (after - before)**2 * (
                    after * found[:, end - 1] - before * found[:, end])]))

    def _bounds(self, controller: ComplexArray, loop: ComplexArray, sensitivity: ComplexArray,
                slopes: ComplexArray) -> tuple[FloatArray, FloatArray]:
        demands = self._demands
        largest = np.where(self._loops.slow, demands.slow_sensitivity,
                           demands.worst_peak_sensitivity)
        peak_db = DECIBELS * np.log(np.abs(sensitivity) / largest)
        padded = np.pad(peak_db, ((0, 0), (1, 1)), constant_values=-np.inf)
        summit = (peak_db >= padded[:, :-2]) & (peak_db >= padded[:, 2:])
        stage, at = np.nonzero((summit & (peak_db > -NEAR_DB)) | (peak_db > -0.1 * NEAR_DB))
        closed = (loop * sensitivity)[stage, at]
        values, found = [peak_db[stage, at]], [-DECIBELS * np.real(closed * slopes[:, at])]
        for output, limit_um_or_v in ((loop[0] * sensitivity[0], demands.added_noise_um),
                                      (controller * sensitivity[0], demands.noise_voltage_v)):
            power = self._parts * np.abs(output)**2
            rms = demands.sensor_noise_um * np.sqrt(power.sum())
            values.append([DECIBELS * np.log(rms / (NOISE_SHARE * limit_um_or_v))])
            found.append(DECIBELS * (np.real(sensitivity[0] * slopes) @ power
                                     / power.sum())[:, None])
        return np.concatenate(values), np.concatenate(found, axis=1).T


def _stable(loop: ComplexArray) -> bool:
    """Return whether no loop encircles -1, by the angle of 1 + L (Nyquist).

    The controller has one pole on the unit circle and none outside: the angle of a stable loop
    starts at -90 degrees at low frequency and returns to 0.
    """
    difference = 1 + loop
    first = np.angle(difference[:, 0])
    first = np.where(first > np.pi / 4, first - 2 * np.pi, first)
    turned = np.angle(difference[:, 1:] / difference[:, :-1]).sum(axis=1)
    return bool((np.abs(first + turned) < 1.0).all())


class TunedFamily:
    """Controllers of a fixed order, which `search` tunes over all stages.

    The tuning begins with the start, whose gain is lowered if it is unstable.
    """

    def __init__(self, model: StageModel, structure: FixedOrder, start: FloatArray,
                 clock_period_s: float) -> None:
        self._model, self.structure, self.start = model, structure, start
        self._clock_period_s = clock_period_s
        self._gain_um_per_v = nominal_hysteresis_gain(model)

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller for given parameters."""
        return (self.structure.controller(numbers, self._clock_period_s)
                * (1 / self._gain_um_per_v))

    def report(self, numbers: FloatArray) -> dict[str, object]:
        """Return the entries of the report that are specific to this family."""
        return {"numbers": list(map(float, numbers))}

    def search(self, loops: PerturbedLoops, demands: Demands, effort: float) -> FloatArray:
        """Return the parameters with the largest margin that was found."""
        frequencies = self._model.dynamics.mode_frequencies_rad_per_s
        problem = LoopProblem(loops, demands, self.structure, min(frequencies) / (2 * np.pi),
                              self._gain_um_per_v)
        low, high = self.structure.bounds
        rng = np.random.default_rng(0)
        start = np.clip(self.start, low, high)
        while not problem.linearise(start).allowed and start[0] > low[0]:
            start[0] -= np.log(2.0)

        def judged(numbers: FloatArray, found: Linearised) -> float:
            """Return the cost; infinite if poles or peaks between the frequencies are worse."""
            figures = loops.measure(self.controller(numbers))
            return np.inf if demands.violation_db(figures) > max(
                0.0, found.bounds.max()) + UNSEEN_DB else found.cost

        best = start
        least = judged(start, problem.linearise(start))
        for trial in range(1 + round(effort * STARTS)):
            tried = best
            if trial:
                changed = rng.random(best.size) < rng.choice(SHARES)
                tried = best + changed * rng.normal(size=best.size) * rng.choice(SIZES)
            numbers, found = lower_largest(problem.linearise, tried, low, high,
                                           FEW_STEPS if trial else STEPS)
            if trial and found.cost < least + PROMISING:
                numbers, found = lower_largest(problem.linearise, numbers, low, high, STEPS)
            if found.allowed and found.cost < least and (cost := judged(numbers, found)) < least:
                best, least = numbers, cost
        return best


@dataclass(frozen=True)
class Start:
    """Initial parameters of the tuning; frequencies are ratios to that of the light mode."""

    gain: float
    """Logarithm of the integral gain."""
    real_zeros: tuple[float, ...]
    real_poles: tuple[float, ...]

    zeros: tuple[tuple[float, float], ...]
    poles: tuple[tuple[float, float], ...]
    """Frequency and damping ratio of each pair."""


START = Start(
    -1.6072, (0.41033, 1.8582), (2.7859,),
    ((11.875, -0.32766), (0.47517, 0.33603), (6.4168, -0.51723), (0.793, 0.048452)),
    ((1.2363, 0.43622), (0.67753, 0.35464), (0.69302, 0.015754), (1.581, 0.14394),
     (0.6709, 0.37591)))
"""Result of such a tuning for the stage of the thesis with its light mode off by 20 %."""

RESONANCES = (((1.1605, 0.098294), (1.0003, 0.0066513)), ((0.97958, 0.13056), (1.0009, 0.0062915)))
"""Zeros and poles of the resonances at the disturbances, relative to their frequency."""


def tuned_family(model: StageModel, demands: Demands, clock_period_s: float) -> TunedFamily:
    """Return the family of controllers with a resonance at each disturbance."""
    unit = model.dynamics.mode_frequencies_rad_per_s[light_mode(model)]
    resonances = [(2 * np.pi * hz / unit, *resonance) for hz, resonance in zip(
        demands.disturbance_hz, cycle(RESONANCES), strict=False)]
    zeros = [*START.zeros, *((hz * ratio, damping) for hz, (ratio, damping), _ in resonances)]
    poles = [*START.poles, *((hz * ratio, damping) for hz, _, (ratio, damping) in resonances)]
    numbers = np.array([
        START.gain, *np.log([*START.real_zeros, *START.real_poles]),
        *(part for ratio, damping in zeros for part in (np.log(ratio), damping)),
        *np.log(poles).ravel()])
    structure = FixedOrder(
        len(START.real_zeros), len(START.real_poles), len(zeros), len(poles), unit)
    return TunedFamily(model, structure, numbers, clock_period_s)
