# SPDX-License-Identifier: BSD-3-Clause
"""Separate noise, even and odd distortion with the lines that a repeated odd multisine omits.

This is the fast method of Pintelon and Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed., 4.3. Differences between periods are noise. A periodic response is even
distortion at even lines, and odd distortion at odd lines that are not excited.

The error of a model, separated in the same way, narrows down its cause before any fit. An error
only at the excited lines has a linear cause. Odd distortion has a symmetric cause such as play or a
cubic spring, even distortion an asymmetric one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.conditioning.sensor_noise import SETTINGS as NOISE
from piezo_identification.conditioning.sensor_noise import repeated_period
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.effects import Effect

EXCITED = 1e-3
"""Smallest amplitude of an excited line, as a fraction of the largest line of the voltage."""

FEWEST_LINES = 8
"""Fewest tones of the voltage for which distortion is estimated."""

FEWEST_PERIODS = 2
"""Fewest periods after the one in which the motion settles; their differences are the noise."""

ABSENT = 0.02
"""Fraction of the linear error below which distortion counts as absent. A spring or sensor with a
curved characteristic has distortion of at least a tenth of its linear error over the quarter of the
range that the experiment uses; play has more."""

NEGLIGIBLE = 1e-3
"""Error that is acceptable for a good model, as a fraction of the response."""


@dataclass(frozen=True)
class NonlinearDistortion:
    """The response of a stage to a repeated odd multisine at each line."""

    frequency_hz: FloatArray
    """Frequencies of all lines up to the highest excited one, without 0, (L,)."""
    is_excited: BoolArray
    is_even: BoolArray
    """Shape (L,)."""
    amplitude_um: FloatArray
    """Amplitude of the mean period, (L,); at lines that are not excited, the linear response to the
    input at that line is subtracted."""
    noise_um: FloatArray
    """Standard deviation of the amplitude of one period, (L,)."""
    periods: int
    """Number of averaged periods."""

    @property
    def is_odd_detection(self) -> BoolArray:
        """Mask of the odd lines that are not excited."""
        return ~self.is_excited & ~self.is_even

    @property
    def answer_um(self) -> float:
        """Response at excited lines: root of the sum of squares, like the following properties."""
        return float(np.sqrt(np.sum(self.amplitude_um[self.is_excited] ** 2)))

    @property
    def linear_um(self) -> float:
        """Response at excited lines, less noise and odd distortion."""
        power = self._power_um2(self.is_excited, self.is_excited)
        odd = self._power_um2(self.is_odd_detection, self.is_excited)
        return float(np.sqrt(max(0.0, power - odd)))

    @property
    def noise_of_period_um(self) -> float:
        """Noise of one period within the band."""
        return float(np.sqrt(np.sum(self.noise_um**2)))

    @property
    def even_um(self) -> float:
        """Even distortion, less the noise."""
        return float(np.sqrt(self._power_um2(self.is_even, self.is_even)))

    @property
    def odd_um(self) -> float:
        """Odd distortion, less the noise.

        It is assumed to be as large at excited lines as at omitted odd lines.
        """
        return float(np.sqrt(self._power_um2(self.is_odd_detection, ~self.is_even)))

    @property
    def significant_um(self) -> float:
        """Smallest significant distortion: three standard deviations of its estimate."""
        lines = max(1, int(np.count_nonzero(self.is_odd_detection)))
        return self.noise_of_period_um * float(np.sqrt(3.0 / (self.periods * np.sqrt(lines))))

    def percent(self, part_um: float) -> float:
        """Return an amplitude in percent of the response."""
        return 100.0 * part_um / self.answer_um

    def _power_um2(self, lines: BoolArray, counted: BoolArray) -> float:
        """Return the power of the counted lines from the mean over some, less the noise."""
        if not np.any(lines):
            return 0.0
        power = self.amplitude_um[lines] ** 2 - self.noise_um[lines] ** 2 / self.periods
        return max(0.0, float(np.mean(power))) * int(np.count_nonzero(counted))


def distortion_of_signal(voltage_v: FloatArray, signal_um: FloatArray, sample_period_s: float,
                         driving: FloatArray | None = None) -> NonlinearDistortion | None:
    """Separate noise and distortion of any response to a voltage, such as a model's residual.

    Voltage and response have the shape (N,); the motion settles in the first period. `driving`,
    (N,), is the input of a linear cause, including its distortion; by default, it is the voltage.
    The result is None if the voltage is not a repeated multisine that omits odd and even lines.
    """
    period = repeated_period(voltage_v)
    if period is None or voltage_v.size // period < FEWEST_PERIODS + 1:
        return None

    def settled(signal: FloatArray) -> FloatArray:
        return signal[period : signal.size // period * period].reshape(-1, period)

    inputs = 2.0 * np.fft.rfft(settled(voltage_v).mean(axis=0))[1:] / period
    sizes = np.abs(inputs)
    is_excited = sizes > EXCITED * sizes.max()
    excited = 1 + np.flatnonzero(is_excited)
    if excited.size < FEWEST_LINES or np.any(excited % 2 == 0) or 2 * excited.size > excited[-1]:
        return None
    if driving is not None:
        inputs = 2.0 * np.fft.rfft(_without_drift(settled(driving)).mean(axis=0))[1:] / period
    lines = np.arange(1, excited[-1] + 1)
    inputs, is_excited = inputs[: lines.size], is_excited[: lines.size]
    outputs = 2.0 * np.fft.rfft(_without_drift(settled(signal_um)), axis=1)[:, lines] / period
    periods, mean_um = len(outputs), outputs.mean(axis=0)
    noise_um = np.sqrt(np.mean(np.abs(outputs - mean_um) ** 2, axis=0) * periods / (periods - 1))
    residual_um = np.where(is_excited, mean_um, mean_um - _linear_um(inputs, mean_um, is_excited))
    return NonlinearDistortion(
        lines / (period * sample_period_s), is_excited, lines % 2 == 0, np.abs(residual_um),
        noise_um, periods)


def _without_drift(periods_um: FloatArray) -> FloatArray:
    """Remove the drift of the period means, as creep would leak into all lines."""
    count, samples = periods_um.shape
    order = min(NOISE.drift_order, count - 1)
    basis = np.polynomial.legendre.legvander(
        np.linspace(-1.0, 1.0, periods_um.size), order)[:, 1:].reshape(count, samples, order)
    means = basis.mean(axis=1)
    middle_um = periods_um.mean(axis=1)
    sizes = np.linalg.lstsq(means - means.mean(axis=0), middle_um - middle_um.mean(), rcond=None)[0]
    return np.asarray(periods_um - basis @ sizes)


def _linear_um(inputs: ComplexArray, mean_um: ComplexArray, is_excited: BoolArray) -> ComplexArray:
    """Return the linear response at each line, with the gain interpolated from excited lines."""
    lines = np.arange(inputs.size)
    gains = mean_um[is_excited] / inputs[is_excited]
    return np.asarray(np.interp(lines, lines[is_excited], gains) * inputs)


@dataclass(frozen=True)
class ErrorDistortion:
    """The response of a stage to an odd multisine, and the error of a model."""

    answer: NonlinearDistortion
    error: NonlinearDistortion
    """Distortion of the measured displacement, and of measured minus simulated displacement."""

    def shown(self) -> frozenset[str]:
        """Return those of "linear", "even" and "odd" that the error contains significantly."""
        parts = {"linear": self.error.linear_um, "even": self.error.even_um,
                 "odd": self.error.odd_um}
        least_um = max(self.error.significant_um, NEGLIGIBLE * self.answer.answer_um)
        return frozenset(name for name, part_um in parts.items() if part_um > least_um
                         and not (name != "linear" and self.is_absent(name)))

    def is_absent(self, kind: str) -> bool:
        """Return whether "even" or "odd" distortion is so small that the linear cause has none."""
        part_um = {"even": self.error.even_um, "odd": self.error.odd_um}[kind]
        most_um = max(part_um, self.error.significant_um)
        return most_um < ABSENT * self.error.linear_um

    def sentence(self) -> str:
        """Describe the parts of the error and the causes that they indicate."""
        answer_um = self.answer.answer_um
        parts = ", ".join(f"{name} {100.0 * part_um / answer_um:.3g} %" for name, part_um in (
            ("linear", self.error.linear_um), ("even", self.error.even_um),
            ("odd", self.error.odd_um), ("noise of a period", self.error.noise_of_period_um)))
        return f"Error of the model over the answer: {parts}. {self._speaks_of()}."

    def _speaks_of(self) -> str:
        shown = self.shown()
        if not shown:
            return "The multisine shows no missing effect"
        if shown == {"linear"}:
            return "No distortion remains: the cause is linear"
        if "even" not in shown:
            return "The distortion is odd alone: the cause is symmetric, such as play"
        if "odd" not in shown:
            return "The distortion is even alone: the cause is asymmetric"
        return "The distortion is even and odd: the cause is nonlinear and not symmetric"


def error_distortion(part: SimulatedRecording, residual_um: FloatArray) -> ErrorDistortion | None:
    """Separate the error of a model into linear error, even and odd distortion, and noise.

    It is None if the voltage is not a repeated multisine that omits odd and even lines.
    """
    answer = distortion_of_signal(part.voltage_v, part.measured_um, part.sample_period_s)
    # A linear cause such as a delay also acts on the distortion of the hysteresis.
    error = distortion_of_signal(
        part.voltage_v, residual_um, part.sample_period_s, part.simulate())
    return None if answer is None or error is None else ErrorDistortion(answer, error)


def excluded_by_distortion(parts: Sequence[SimulatedRecording],
                           kinds: Sequence[type[Effect]]) -> dict[str, str]:
    """Return why effects are excluded: the error lacks their distortion.

    Nothing is excluded without an odd multisine among the recordings.
    """
    excluded: dict[str, str] = {}
    for part in parts:
        found = error_distortion(part, part.measured_um - part.simulate())
        if found is None:
            continue
        absent = {kind for kind in ("even", "odd") if found.is_absent(kind)}
        for kind in kinds:
            if kind.distortion and kind.distortion <= absent:
                missing = " or ".join(sorted(kind.distortion))
                excluded[kind.name] = f"the multisine shows no {missing} distortion"
    return excluded
