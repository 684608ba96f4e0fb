# SPDX-License-Identifier: BSD-3-Clause
"""References made of periodic waves: a sine, a triangle, or a sum of sines (4.21)."""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.special import sici

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import (
    LONGEST_PERIOD_S,
    Components,
    NoPeriod,
    Reference,
    Watch,
    components,
)
from piezo_controller.references.trajectory import FormulaTrajectory, Trajectory

Shape = Callable[[FloatArray, float], FloatArray]

BANDWIDTH_HZ = 2000.0
# For more sines a closed formula is used: the ideal triangle less the remaining terms.
MOST_SUMMED = 500


class Waves:
    """Waves of one shape, each with its frequency, amplitude and phase; some at most.

    The shape returns the wave (-1 to 1), given its angle (rad) and frequency (Hz).
    """

    def __init__(self, shape: Shape, most: float = 1) -> None:
        self._shape = shape
        self._most = most

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return whether a common period of all waves is short enough."""
        try:
            _common_period(self._components(reference, sample_rate_hz)[0], sample_rate_hz)
        except NoPeriod:
            return False
        return True

    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Sample the shortest period that holds whole cycles of every wave."""
        frequencies, amplitudes, phases = self._components(reference, sample_rate_hz)
        cycles, length = _common_period(frequencies, sample_rate_hz)
        displacement_um = np.full(length, float(reference.centre_um))
        for cycle, frequency_hz, amplitude_um, phase in zip(cycles, frequencies, amplitudes, phases,
                                                            strict=True):
            turns = (cycle.numerator * (length // cycle.denominator) * np.arange(length)) % length
            angle_rad = 2 * np.pi * turns / length + phase
            displacement_um += amplitude_um / 2 * self._shape(angle_rad, frequency_hz)
        return displacement_um

    def trajectory(self, reference: Reference, sample_rate_hz: float, watch: Watch) -> Trajectory:
        """Return the formula's trajectory, with or without a period."""
        waves = list(zip(*self._components(reference, sample_rate_hz), strict=True))
        centre_um = float(reference.centre_um)

        def formula(at: NDArray[np.int64]) -> FloatArray:
            sample = at.astype(float)
            displacement_um = np.full(at.size, centre_um)
            for frequency_hz, amplitude_um, phase in waves:
                angle_rad = 2 * np.pi * (sample * (frequency_hz / sample_rate_hz) % 1.0) + phase
                displacement_um += amplitude_um / 2 * self._shape(angle_rad, frequency_hz)
            return displacement_um

        return FormulaTrajectory(formula)

    def _components(self, reference: Reference, sample_rate_hz: float) -> Components:
        return components(reference, sample_rate_hz, self._most)


def _common_period(frequencies_hz: Sequence[float],
                   sample_rate_hz: float) -> tuple[list[Fraction], int]:
    """Return each frequency in cycles per sample, and the samples of the common period."""
    cycles = [_cycles_per_sample(f, sample_rate_hz) for f in frequencies_hz]
    length = math.lcm(*(c.denominator for c in cycles))
    if length > LONGEST_PERIOD_S * sample_rate_hz:
        raise NoPeriod(
            f"the common period of the frequencies is {length / sample_rate_hz:g} s, longer than "
            f"{LONGEST_PERIOD_S:g} s: use multiples of {1 / LONGEST_PERIOD_S:g} Hz")
    return cycles, length


def _cycles_per_sample(frequency_hz: float, sample_rate_hz: float) -> Fraction:
    """Return the frequency (cycles per sample) as a fraction whose period is short enough."""
    wanted = frequency_hz / sample_rate_hz
    longest = int(LONGEST_PERIOD_S * sample_rate_hz)
    # The continued fraction finds the shortest exact period first.
    for limit in np.unique(np.geomspace(2, longest, 200).astype(int)):
        fraction = Fraction(wanted).limit_denominator(int(limit))
        if abs(float(fraction) - wanted) <= 1e-10 * wanted:
            return fraction
    step_hz = 1 / LONGEST_PERIOD_S
    possible = [max(round(frequency_hz / step_hz), 1) * step_hz,
                sample_rate_hz / min(round(sample_rate_hz / frequency_hz), longest)]
    nearest_hz = min(possible, key=lambda hz: abs(hz - frequency_hz))
    raise NoPeriod(
        f"{frequency_hz:.12g} Hz has no period of whole samples within {LONGEST_PERIOD_S:g} s at "
        f"{sample_rate_hz:g} samples a second: the nearest that has is {nearest_hz:.12g} Hz")


def _sine(angle_rad: FloatArray, _frequency_hz: float) -> FloatArray:
    return np.sin(angle_rad)


def triangle_wave(angle_rad: FloatArray, frequency_hz: float) -> FloatArray:
    """Return the Fourier series of a unit triangle up to 2 kHz, rising through zero at angle 0."""
    orders = max(int((BANDWIDTH_HZ / frequency_hz + 1 + 1e-9) // 2), 1)
    return _summed(angle_rad, orders) if orders <= MOST_SUMMED else _closed(angle_rad, orders)


def _summed(angle_rad: FloatArray, orders: int) -> FloatArray:
    odd = np.arange(1, 2 * orders, 2)
    wave = np.zeros_like(angle_rad)
    for order, sign in zip(odd, np.where(odd % 4 == 1, 1.0, -1.0), strict=True):
        wave += sign * np.sin(order * angle_rad) / order**2
    return wave / np.sum(1 / odd.astype(float) ** 2)


def _closed(angle_rad: FloatArray, orders: int) -> FloatArray:
    """Return the same to within 1e-9, at a cost that does not depend on the number of orders."""
    from_crest = np.abs(np.mod(angle_rad + np.pi / 2, 2 * np.pi) - np.pi)
    from_tip = np.minimum(from_crest, np.pi - from_crest)
    sign = np.where(from_crest < np.pi / 2, 1.0, -1.0)
    straight = np.pi / 4 * (np.pi / 2 - from_tip)
    return sign * (straight - _left_out(from_tip, orders)) / (
        np.pi**2 / 8 - _left_out(np.zeros(1), orders))


def _left_out(distance: FloatArray, orders: int) -> FloatArray:
    """Return the sum of cos(k d) / k**2 over the odd k above 2 orders.

    The sum is replaced by an integral over k; sin(d) / d corrects the error of the midpoint rule.
    """
    first = 2.0 * orders
    integral = np.cos(first * distance) / first - distance * (
        np.pi / 2 - sici(first * distance)[0])
    return integral / 2 / np.sinc(distance / np.pi)


HARMONIC = Waves(_sine)
MULTI_FREQUENCY = Waves(_sine, most=math.inf)
TRIANGLE = Waves(triangle_wave)
