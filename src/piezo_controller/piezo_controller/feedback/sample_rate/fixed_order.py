# SPDX-License-Identifier: BSD-3-Clause
"""A controller of fixed order with an integration, zeros and poles, and its derivatives."""

from dataclasses import dataclass

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray

FASTEST, SLOWEST = 16.0, 1e-3
"""Bounds of poles and zeros, as ratios to the unit of frequency."""

ZERO_DAMPING, POLE_DAMPING = (-3.0, 6.0), (0.004, 5.0)
"""Bounds of the damping ratios: zeros may lie on either side, poles are stable."""


@dataclass(frozen=True)
class FixedOrder:
    """Controllers with given numbers of zeros and poles.

    The parameters are the logarithm of the integral gain, the logarithms of the real zeros and
    poles, and for each pair the logarithm of its frequency and its damping ratio (for poles the
    logarithm of that). Each factor is 1 at zero frequency.
    """

    real_zeros: int
    real_poles: int
    zero_pairs: int
    pole_pairs: int
    """Number of each; the pole of the integration is not counted."""
    unit_rad_per_s: float
    """Unit of the frequencies."""

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper bounds of the parameters."""
        frequency = [(np.log(SLOWEST), np.log(FASTEST))]
        low, high = np.array(
            [(-12.0, 6.0), *(self.real_zeros + self.real_poles) * frequency,
             *self.zero_pairs * [*frequency, ZERO_DAMPING],
             *self.pole_pairs * [*frequency, tuple(np.log(POLE_DAMPING))]]).T
        return low, high

    def response(self, numbers: FloatArray,
                 points: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the response, (F,), and the derivatives of its logarithm, (n, F).

        The derivatives are those by the parameters; the points are values of the Laplace variable
        (rad/s).
        """
        s = points / self.unit_rad_per_s
        gain, zeros, poles, zero_pairs, pole_pairs = self._parts(numbers)
        response = np.exp(gain) / s
        rows = [np.ones_like(s)]
        for reals, power in ((zeros, 1), (poles, -1)):
            for frequency in reals:
                factor = 1 + s / frequency
                response = response * factor**power
                rows.append(-power * s / frequency / factor)
        for pairs, power in ((zero_pairs, 1), (pole_pairs, -1)):
            for frequency, damping in pairs:
                u = s / frequency
                factor = u * u + 2 * damping * u + 1
                response = response * factor**power
                by_damping = 2 * u / factor * (1.0 if power == 1 else damping)
                rows += [-power * 2 * u * (u + damping) / factor, power * by_damping]
        return response, np.array(rows)

    def controller(self, numbers: FloatArray, period_s: float) -> control.StateSpace:
        """Return the discrete controller by Tustin's rule, as a chain of sections."""
        gain, zeros, poles, zero_pairs, pole_pairs = self._parts(numbers)
        numerators = [*map(_pair, zero_pairs), *([1 / zero, 1.0] for zero in zeros)]
        denominators = [*map(_pair, pole_pairs), *([1 / pole, 1.0] for pole in poles), [1.0, 0.0]]
        # Zeros do not come before their poles, so that every section is proper.
        numerators += [[1.0]] * (len(denominators) - len(numerators))
        system = control.ss([], [], [], [[np.exp(gain)]])
        for numerator, denominator in zip(numerators, denominators, strict=True):
            system = system * control.ss(control.tf(numerator, denominator))
        # In units of the frequency, so that the elements are of similar magnitude.
        sampled = system.sample(period_s * self.unit_rad_per_s, method="bilinear")
        return control.ss(sampled.A, sampled.B, sampled.C, sampled.D, period_s)

    def _parts(self, numbers: FloatArray) -> tuple[
            float, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the gain's logarithm, real zeros, real poles, zero pairs and pole pairs."""
        first, *ends = np.cumsum([1, self.real_zeros, self.real_poles, 2 * self.zero_pairs])
        gain, zeros, poles, zero_pairs, pole_pairs = np.split(
            np.asarray(numbers, dtype=float), [first, *ends])
        zero_pairs, pole_pairs = zero_pairs.reshape(-1, 2), pole_pairs.reshape(-1, 2)
        return (float(gain[0]), np.exp(zeros), np.exp(poles),
                np.column_stack([np.exp(zero_pairs[:, 0]), zero_pairs[:, 1]]),
                np.exp(pole_pairs))


def _pair(pair: FloatArray) -> list[float]:
    frequency, damping = pair
    return [1 / frequency**2, 2 * damping / frequency, 1.0]
