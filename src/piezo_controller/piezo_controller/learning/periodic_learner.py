# SPDX-License-Identifier: BSD-3-Clause
"""Learn the feedforward of a periodic reference from its own errors.

The correction is a Fourier series that is added to the reference before it is inverted. An
iteration plays some periods, decomposes their mean error into harmonics, and changes each harmonic
by the error divided by the expected response (iterative learning). The observed effect of a change
then corrects that response (adaptive Fourier coefficients).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_controller.feedforward.periodic import BANDWIDTH_HZ

GAIN = 1.0
# Ratio of the error to the noise of its mean below which the learning ends.
FLOOR_RATIO = 1.5
# Factors by which an error grows that are not due to noise.
GROWTH, DIVERGED_RATIO = 1.5, 3.0
DIVERGENCES = 2
# The learning ends after so many iterations in which the error does not fall by a twentieth.
PATIENCE = 3
IMPROVEMENT = 0.95
# Relative errors of the expected response, its change per iteration, and the part of the largest
# harmonic's change that the hysteresis may add to the others.
RESPONSE_UNCERTAINTY = 0.3
RESPONSE_DRIFT = 0.03
COUPLING = 0.1
# Harmonics whose noise would take more than this part of the reference's drive are not corrected:
# near the reversals the hysteresis turns such ripples into further errors.
LARGEST_RIPPLE = 5e-4
NEGLIGIBLE_CONTENT = 1e-3


@dataclass(frozen=True)
class Measured:
    """Error of the mean period."""

    harmonics_um: ComplexArray
    """Reference minus displacement, (H,); the phase is that of a cosine from the period's start."""
    noise_um: float
    """Standard deviation of each harmonic (of real and imaginary part together)."""

    @property
    def rms_um(self) -> float:
        """Return the rms of all harmonics together."""
        return float(np.sqrt(np.sum(np.abs(self.harmonics_um) ** 2) / 2))

    @property
    def floor_um(self) -> float:
        """Return the value of `rms_um` due to noise alone."""
        return float(np.sqrt(self.harmonics_um.size / 2) * self.noise_um)


class PeriodicLearner:
    """Corrects a periodic reference, one period of which is given, iteration by iteration.

    The expected response from a correction to the displacement, complex, at frequencies in Hz, is
    the sensitivity of the feedback, if there is one. The effort is the expected magnitude of the
    input per unit of displacement there. The correction, (P,), may begin with an earlier one.

    `iterations` is the number of those that were measured, `finished` tells why the learning has
    ended, and is empty while it continues.
    """

    def __init__(self, reference_um: ArrayLike, response: Callable[[FloatArray], ComplexArray],
                 effort: Callable[[FloatArray], ComplexArray], sample_period_s: float,
                 correction_um: FloatArray | None = None) -> None:
        self._reference_um = np.asarray(reference_um, dtype=float)
        self._period = self._reference_um.size
        count = min(int(BANDWIDTH_HZ * self._period * sample_period_s + 1e-9),
                    (self._period - 1) // 2)
        if count < 1:
            raise ValueError("the reference has no harmonic that can be learned")
        self._orders = np.arange(1, count + 1)
        frequency_hz = self._orders / (self._period * sample_period_s)
        self._response = np.asarray(response(frequency_hz), dtype=complex)
        self._effort = np.abs(effort(frequency_hz))
        self._forget_responses()
        self._correction = self._harmonics(
            np.zeros(self._period) if correction_um is None else correction_um)
        self._best = self._correction.copy()
        self._last: tuple[ComplexArray, Measured] | None = None
        self._gain = GAIN
        self._since_better = self._divergences = 0
        self.iterations = 0
        self.finished = ""
        self.best_rms_um = np.inf

    @property
    def correction_um(self) -> FloatArray:
        """Return one period of the correction to play next."""
        return self._wave(self._correction)

    @property
    def best_um(self) -> FloatArray:
        """Return one period of the correction with the smallest error."""
        return self._wave(self._best)

    def limit_to(self, correction_um: FloatArray) -> None:
        """Set the correction that was played because `correction_um` was out of reach."""
        self._correction = self._harmonics(correction_um)

    def measure(self, displacement_um: FloatArray) -> Measured:
        """Decompose the mean error of some periods into harmonics.

        The displacement covers whole periods, at least two, (n P,); a linear drift is removed.
        """
        error_um = np.resize(self._reference_um, displacement_um.size) - displacement_um
        periods = error_um.reshape(-1, self._period)
        means = periods.mean(axis=1)
        drift = np.polyfit(np.arange(means.size), means, 1)[0] / self._period
        periods = (error_um - drift * np.arange(error_um.size)).reshape(-1, self._period)
        harmonics = np.array([self._harmonics(period) for period in periods])
        mean = harmonics.mean(axis=0)
        scatter = np.sum(np.abs(harmonics - mean) ** 2) / (means.size - 1)
        return Measured(mean, float(np.sqrt(scatter / (mean.size * means.size))))

    def learn(self, displacement_um: FloatArray) -> Measured:
        """Evaluate the periods measured with `correction_um`, and compute the next correction.

        For the displacement see `measure`.
        """
        measured = self.measure(displacement_um)
        self.iterations += 1
        rms_um = measured.rms_um
        improved = rms_um < IMPROVEMENT * self.best_rms_um
        diverged = rms_um > max(GROWTH * self.best_rms_um, DIVERGED_RATIO * measured.floor_um)
        if rms_um < self.best_rms_um:
            self.best_rms_um, self._best = rms_um, self._correction.copy()
        self._since_better = 0 if improved else self._since_better + 1
        if rms_um <= FLOOR_RATIO * measured.floor_um:
            self.finished = "the noise floor is reached"
        elif diverged:
            self._return_to_best()
        elif self._since_better >= PATIENCE:
            self.finished = "the error does not fall any more"
        if not diverged:
            self._adapt(measured)
            self._last = self._correction.copy(), measured
            self._step(measured)
        return measured

    def _return_to_best(self) -> None:
        self._divergences += 1
        self._gain /= 2
        self._forget_responses()
        self._correction, self._last = self._best.copy(), None
        if self._divergences >= DIVERGENCES:
            self.finished = "the iteration diverged: the best is kept"

    def _forget_responses(self) -> None:
        """Reset each harmonic's expected response to that of the model, as a real matrix."""
        real, imaginary = self._response.real, self._response.imag
        self._expected = np.moveaxis(np.array([[real, -imaginary], [imaginary, real]]), -1, 0)
        self._scale = np.abs(self._response)[:, None, None] ** 2 * np.eye(2)
        self._variance = RESPONSE_UNCERTAINTY**2 * self._scale

    def _adapt(self, measured: Measured) -> None:
        """Correct the expected responses by the observed effect of the last change (Kalman filter).

        Around a large oscillation the hysteresis, and the feedback around it, responds differently
        to a change of the amplitude and of the phase. Each response is therefore a real matrix.
        """
        if self._last is None:
            return
        before, last = self._last
        change = _parts(self._correction - before)
        effect = _parts(last.harmonics_um - measured.harmonics_um)
        spread = (last.noise_um**2 + measured.noise_um**2
                  + (COUPLING * np.abs(effect).max()) ** 2)
        self._variance = self._variance + RESPONSE_DRIFT**2 * self._scale
        seen = np.einsum("hij,hj->hi", self._variance, change)
        weight = seen / (np.sum(change * seen, axis=1) + spread)[:, None]
        surprise = effect - np.einsum("hij,hj->hi", self._expected, change)
        self._expected = self._expected + surprise[:, :, None] * weight[:, None, :]
        self._variance = self._variance - weight[:, :, None] * seen[:, None, :]

    def _step(self, measured: Measured) -> None:
        """Change each harmonic by the part of its error that is not noise."""
        power = np.abs(measured.harmonics_um) ** 2
        real = np.clip(1 - measured.noise_um**2 / np.maximum(power, 1e-30), 0.0, 1.0)
        real[self._too_fine(measured.noise_um)] = 0.0
        change = np.linalg.solve(
            self._expected, _parts(real * measured.harmonics_um)[:, :, None])[:, :, 0]
        self._correction = self._correction + self._gain * (change[:, 0] + 1j * change[:, 1])

    def _too_fine(self, noise_um: float) -> BoolArray:
        """Mark harmonics absent from the reference whose noise would take much of the drive."""
        content = np.abs(self._harmonics(self._reference_um))
        drive_um = np.max(content * self._effort)
        return ((content < NEGLIGIBLE_CONTENT * content.max())
                & (noise_um * self._effort > LARGEST_RIPPLE * drive_um))

    def _harmonics(self, wave_um: FloatArray) -> ComplexArray:
        return 2 * np.fft.rfft(wave_um)[self._orders] / self._period

    def _wave(self, harmonics: ComplexArray) -> FloatArray:
        content = np.zeros(self._period // 2 + 1, dtype=complex)
        content[self._orders] = harmonics * self._period / 2
        return np.fft.irfft(content, self._period)


def _parts(harmonics: ComplexArray) -> FloatArray:
    return np.stack([harmonics.real, harmonics.imag], axis=1)
