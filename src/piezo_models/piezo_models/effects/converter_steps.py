# SPDX-License-Identifier: BSD-3-Clause
"""Quantisation by the converters of the applied voltage and of the measured displacement."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.linear.dynamics import simulate_linear, zoh

BINS, FEWEST_STEPS, PADDING = 2**14, 16, 4
"""Bins of the voltage in which a period is sought; fewest steps in the range that can be
identified; factor by which the spectrum is interpolated."""

LEAST_SHARE = 0.1
"""The fundamental of the steps must hold at least this fraction of the residual's energy, or they
are not fitted. Of a residual of steps alone it holds six tenths."""

FEWEST_LEVELS = 50
ON_LATTICE, NEAR = 0.95, 0.1
"""Fraction of the readings that lie on the lattice, and largest distance in steps to count as on
it."""

LEAST_STEP = 1e-4
"""Fraction of the travel below which steps are finer than the error of a good model."""

IDEAL = (0.7, 1.3)
"""Range of the share of a converter, which rounds by its whole step; outside it is not one."""


def rounded_off(signal: FloatArray, step: float, offset: float) -> FloatArray:
    """Return the change of a signal by a converter, (N,), given its step and one of its levels."""
    return np.asarray(step * np.round((signal - offset) / step) + offset - signal)


@dataclass(frozen=True)
class ConverterSteps(Effect):
    """A converter rounds a signal to its levels; a share of 1 is full rounding."""

    remembers: ClassVar[bool] = False

    share: float = parameter("1", "linear", 0.0, 2.0)

    @abstractmethod
    def step_and_offset(self) -> tuple[float, float]:
        """Return the distance between levels, and one of them."""

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal at the converter's levels."""
        return signal + self.share * rounded_off(signal, *self.step_and_offset())

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the wanted signal, as no other one comes nearer to it through the steps."""
        return wanted

    def impossible(self, extent: Extent) -> str | None:
        """Reject a share that is not that of rounding by whole steps."""
        if IDEAL[0] <= self.share <= IDEAL[1]:
            return None
        return f"a converter rounds by its whole step, and this would be {self.share:.2g} of it"


@dataclass(frozen=True)
class VoltageSteps(ConverterSteps):
    """The amplifier's converter applies the voltage in steps, which the recording does not contain.

    The share is relative to an ideal converter: 1 for rounding to the nearest level.
    """

    name: ClassVar[str] = "voltage_steps"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "a slow ramp over a small part of the range"

    step_v: float = parameter("V", "fixed", LEAST, MOST)
    offset_v: float = parameter("V", "fixed")

    def step_and_offset(self) -> tuple[float, float]:
        """Return both in V."""
        return self.step_v, self.offset_v

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require a voltage with many levels."""
        voltage_v = evidence.voltage_v
        levels = np.unique(voltage_v[:: max(1, voltage_v.size // BINS)]).size
        if levels < FEWEST_LEVELS:
            return "the voltage has too few levels to show steps between them"
        return None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the period of the voltage at which the residual repeats."""
        voltage_v = evidence.voltage_v
        lowest_v, span_v = float(voltage_v.min()), float(np.ptp(voltage_v))
        if span_v == 0.0:
            return []
        bins = np.minimum((voltage_v - lowest_v) / span_v * BINS, BINS - 1).astype(np.intp)
        sums = np.bincount(bins, evidence.residual_um - evidence.residual_um.mean(), BINS)
        power = np.abs(np.fft.rfft(sums, PADDING * BINS))
        power[: PADDING * FEWEST_STEPS] = 0.0
        power[len(power) // 2 :] = 0.0
        count = float(np.argmax(power)) / PADDING
        angle = 2.0 * np.pi * (voltage_v - lowest_v) / span_v

        dynamics = zoh(evidence.dynamics.state_space(), evidence.sample_period_s)

        def waves(number: float) -> FloatArray:
            return np.column_stack([
                simulate_linear(dynamics, wave(number * angle)) for wave in (np.cos, np.sin)])

        if evidence.reduction(waves(count))[1] < 0.5 * LEAST_SHARE:
            return []
        (count, gains), = evidence.best(count + np.linspace(-0.3, 0.3, 13), waves)
        if evidence.reduction(waves(count))[1] < LEAST_SHARE:
            return []
        step_v = span_v / float(count)
        # Rounding subtracts a sine that starts at the offset; its amplitude is the step over pi.
        cosine_um, sine_um = (float(gain) for gain in gains)
        size_um = evidence.travel_um / span_v * step_v / np.pi
        offset_v = lowest_v + step_v * np.arctan2(cosine_um, -sine_um) / (2.0 * np.pi)
        share = float(np.hypot(cosine_um, sine_um)) / size_um
        return [cls(min(share, 2.0), step_v, offset_v)]


@dataclass(frozen=True)
class SensorSteps(ConverterSteps):
    """The sensor's converter reads the displacement in steps."""

    name: ClassVar[str] = "sensor_steps"
    place: ClassVar[str] = "sensor"
    experiment: ClassVar[str] = "slow motion over a small part of the range"

    step_um: float = parameter("um", "fixed", LEAST, MOST)
    offset_um: float = parameter("um", "fixed")

    def step_and_offset(self) -> tuple[float, float]:
        """Return both in um."""
        return self.step_um, self.offset_um

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the lattice of the readings, if it is coarser than the noise."""
        measured_um = evidence.measured_um
        lattice = None if measured_um is None else _lattice(measured_um)
        if measured_um is None or lattice is None:
            return []
        step_um, level_um = lattice
        if step_um < max(LEAST_STEP * evidence.travel_um, evidence.noise_um):
            return []
        # The displacement of the model has another zero than the measured one.
        apart_um = np.mean(measured_um - evidence.residual_um - evidence.displacement_um)
        return [cls(1.0, step_um, float((level_um - apart_um) % step_um))]


def _lattice(readings: FloatArray) -> tuple[float, float] | None:
    """Return the step and one level of the lattice of the readings; None if there is none."""
    levels = np.unique(readings)
    if not 8 <= levels.size <= 0.5 * readings.size:
        return None
    gaps = np.diff(levels)
    least = np.sort(gaps)[gaps.size // 20]
    numbers = np.concatenate([[0.0], np.cumsum(np.round(gaps / least))])
    slope, level = np.polyfit(numbers, levels, 1)
    off = np.abs(rounded_off(readings, slope, level))
    return (float(slope), float(level)) if np.mean(off < NEAR * slope) > ON_LATTICE else None
