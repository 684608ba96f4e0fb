# SPDX-License-Identifier: BSD-3-Clause
"""Separate noise, even and odd distortion with the lines that a repeated odd multisine omits.

This is the fast method of Pintelon and Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed., 4.3. Differences between periods are noise. A periodic response is even
distortion at even lines, and odd distortion at odd lines that are not excited.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.conditioning.sensor_noise import SETTINGS as NOISE
from piezo_identification.conditioning.sensor_noise import repeated_period
from piezo_recorder.reading.recording import Recording

EXCITED = 1e-3
"""Smallest amplitude of an excited line, as a fraction of the largest line of the voltage."""

FEWEST_LINES = 8
"""Fewest tones of the voltage for which distortion is estimated."""

FEWEST_PERIODS = 2
"""Fewest periods after the one in which the motion settles; their differences are the noise."""


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
        power = self._power_um2(self.is_excited, int(np.count_nonzero(self.is_excited)))
        odd = self._power_um2(self.is_odd_detection, int(np.count_nonzero(self.is_excited)))
        return float(np.sqrt(max(0.0, power - odd)))

    @property
    def noise_of_period_um(self) -> float:
        """Noise of one period within the band."""
        return float(np.sqrt(np.sum(self.noise_um**2)))

    @property
    def even_um(self) -> float:
        """Even distortion, less the noise."""
        return float(np.sqrt(
            self._power_um2(self.is_even, int(np.count_nonzero(self.is_even)))))

    @property
    def odd_um(self) -> float:
        """Odd distortion, less the noise.

        It is assumed to be as large at excited lines as at omitted odd lines.
        """
        return float(np.sqrt(
            self._power_um2(self.is_odd_detection, int(np.count_nonzero(~self.is_even)))))

    @property
    def significant_um(self) -> float:
        """Smallest significant distortion: three standard deviations of its estimate."""
        lines = max(1, int(np.count_nonzero(self.is_odd_detection)))
        return self.noise_of_period_um * float(np.sqrt(3.0 / (self.periods * np.sqrt(lines))))

    def percent(self, part_um: float) -> float:
        """Return an amplitude in percent of the response."""
        return 100.0 * part_um / self.answer_um

    def _power_um2(self, lines: BoolArray, count: int) -> float:
        """Return the power of `count` lines from the mean over some, less the noise."""
        if not np.any(lines):
            return 0.0
        power = self.amplitude_um[lines] ** 2 - self.noise_um[lines] ** 2 / self.periods
        return max(0.0, float(np.mean(power))) * count


def nonlinear_distortion(voltage_v: FloatArray, displacement_um: FloatArray,
                         sample_period_s: float, driving: FloatArray | None = None,
                         ) -> NonlinearDistortion:
    """Separate noise, even and odd distortion.

    Parameters
    ----------
    voltage_v, displacement_um : ndarray, shape (P, N)
        Periods of the multisine, without the one in which the motion settles.
    driving : ndarray, shape (P, N), optional
        Input of a linear cause, including its distortion; the voltage by default.

    Raises
    ------
    ValueError
        If there are too few periods, or the voltage omits no odd or no even line.
    """
    periods, samples = displacement_um.shape
    if periods < FEWEST_PERIODS:
        raise ValueError(f"{periods} settled periods are given: give at least {FEWEST_PERIODS}, "
                         "as noise is what differs between them")
    inputs = 2.0 * np.fft.rfft(voltage_v.mean(axis=0))[1:] / samples
    steady_um = _without_drift(displacement_um)
    outputs = 2.0 * np.fft.rfft(steady_um, axis=1)[:, 1:] / samples
    sizes = np.abs(inputs)
    is_excited = sizes > EXCITED * sizes.max()
    count = int(np.flatnonzero(is_excited)[-1]) + 1
    lines = np.arange(1, count + 1)
    if driving is not None:
        inputs = 2.0 * np.fft.rfft(_without_drift(driving).mean(axis=0))[1:] / samples
    inputs, is_excited, is_even = inputs[:count], is_excited[:count], lines % 2 == 0
    if np.any(is_excited & is_even) or np.all(is_excited | is_even):
        raise ValueError("the voltage excites even lines or every odd one: "
                         "record the experiment 'distortion'")
    mean_um = outputs[:, :count].mean(axis=0)
    noise_um = np.sqrt(np.mean(np.abs(outputs[:, :count] - mean_um) ** 2, axis=0)
                       * periods / (periods - 1))
    residual_um = np.where(is_excited, mean_um, mean_um - _linear_um(inputs, mean_um, is_excited))
    return NonlinearDistortion(
        lines / (samples * sample_period_s), is_excited, is_even, np.abs(residual_um), noise_um,
        periods)


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


def distortion_of(recording: Recording) -> NonlinearDistortion | None:
    """Separate noise and distortion of a recording without gaps; see `distortion_of_signal`."""
    return distortion_of_signal(
        np.asarray(recording.voltage_v, dtype=float),
        np.asarray(recording.displacement_um, dtype=float), recording.sample_period_s)


def distortion_of_signal(voltage_v: FloatArray, signal_um: FloatArray, sample_period_s: float,
                         driving: FloatArray | None = None) -> NonlinearDistortion | None:
    """Separate noise and distortion of any response to a voltage, such as a model's residual.

    Parameters
    ----------
    voltage_v, signal_um : ndarray, shape (N,)
        Voltage and response; the motion settles in the first period.
    driving : ndarray, shape (N,), optional
        Input of a linear cause; the voltage by default.

    Returns
    -------
    NonlinearDistortion or None
        None if the voltage is not a repeated multisine that omits odd and even lines.
    """
    period = repeated_period(voltage_v)
    if period is None or voltage_v.size // period < FEWEST_PERIODS + 1:
        return None
    whole = slice(period, voltage_v.size // period * period)
    sizes = np.abs(np.fft.rfft(voltage_v[whole][:period]))[1:]
    lines = 1 + np.flatnonzero(sizes > EXCITED * sizes.max())
    if lines.size < FEWEST_LINES or np.any(lines % 2 == 0) or 2 * lines.size > lines[-1]:
        return None
    return nonlinear_distortion(
        voltage_v[whole].reshape(-1, period), signal_um[whole].reshape(-1, period),
        sample_period_s, None if driving is None else driving[whole].reshape(-1, period))
