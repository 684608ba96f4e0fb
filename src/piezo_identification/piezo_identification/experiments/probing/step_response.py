# SPDX-License-Identifier: BSD-3-Clause
"""Decompose a measured step response into decaying exponentials: modes, lags and settling."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import hankel, lstsq, svd

from piezo_common.arrays import ComplexArray, FloatArray

LEAST_MODE_SHARE, LEAST_LAG_SHARE = 0.01, 0.05
"""Smallest vibration and lag as fractions of the step; smaller or slower parts are creep."""

LARGEST_DAMPING = 0.9
"""Damping ratio above which a pair of poles does not ring visibly."""

REMAINDER = 0.01
"""The response has settled when it is within this fraction of the step of its end."""

SIGNIFICANT = 4.0
"""Standard deviations of the noise above which an amplitude is significant."""

MOST_POINTS = 1200
"""Most samples in a fit. The singular values of a Hankel matrix with a third as many columns take a
fraction of a second."""

POINTS_PER_CYCLE = 5.0
"""Samples per cycle of the highest frequency in the response."""


@dataclass(frozen=True)
class StepResponse:
    """A step response as a sum of exponentials."""

    poles_rad_per_s: ComplexArray
    """Shape (P,)."""
    shares: ComplexArray
    """Amplitude of each exponential at the step, as a fraction of the step, (P,)."""
    final_share: float
    """Constant part, 1 without creep."""
    sample_period_s: float

    @property
    def modes(self) -> list[tuple[float, float, float]]:
        """Natural frequency in Hz, damping ratio and share of each vibration, largest first."""
        found = []
        for pole, share in zip(self.poles_rad_per_s, self.shares, strict=True):
            damping = -pole.real / abs(pole)
            if pole.imag > 0.0 and damping < LARGEST_DAMPING and (
                    2.0 * abs(share) > LEAST_MODE_SHARE):
                found.append((abs(pole) / (2.0 * np.pi), float(damping), 2.0 * abs(share)))
        return sorted(found, key=lambda mode: -mode[2])

    @property
    def lag_s(self) -> float:
        """Time constant of the largest part that decays without ringing; 0 if there is none."""
        lags = [(abs(share), -1.0 / pole.real)
                for pole, share in zip(self.poles_rad_per_s, self.shares, strict=True)
                if pole.imag == 0.0 and abs(share) > LEAST_LAG_SHARE]
        return float(max(lags, default=(0.0, 0.0))[1])

    @property
    def settling_s(self) -> float:
        """Time after which each fast part has decayed to 1 % of the step."""
        times_s = [4.0 * self.sample_period_s]
        for pole, share in zip(self.poles_rad_per_s, self.shares, strict=True):
            part = abs(share) * (2.0 if pole.imag else 1.0)
            if part > (LEAST_MODE_SHARE if pole.imag else LEAST_LAG_SHARE):
                times_s.append(np.log(part / REMAINDER) / -pole.real)
        return float(max(times_s))

    def magnitude(self, frequency_hz: float) -> float:
        """Return the gain at a frequency over the static gain."""
        s = 2j * np.pi * frequency_hz
        return float(abs(self.final_share + np.sum(
            self.shares * s / (s - self.poles_rad_per_s))))


def step_response(response: FloatArray, noise: float, sample_period_s: float) -> StepResponse:
    """Fit a step response by a matrix pencil (Hua and Sarkar, IEEE Trans. ASSP 38, 1990).

    The response, (N,), is 0 at the step and about 1 at the end.
    """
    response = np.asarray(response, dtype=float)
    begin = _first_motion(response, noise)
    window, every = _window_and_decimation(response[begin:], noise)
    part = response[begin:begin + window * every:every]
    poles = _pencil_poles(part, noise)
    powers = poles[None, :] ** np.arange(part.size)[:, None]
    amplitudes = lstsq(np.column_stack([np.ones(part.size), powers]), part.astype(complex))[0]
    rates = np.log(poles) / (every * sample_period_s)
    # Amplitudes are taken at the first motion, which may be some samples after the step.
    shares = amplitudes[1:]
    kept = (np.abs(shares) > SIGNIFICANT * noise / np.sqrt(part.size)) & (rates.real < 0.0)
    return StepResponse(rates[kept], shares[kept], float(amplitudes[0].real), sample_period_s)


def _first_motion(response: FloatArray, noise: float) -> int:
    moved = np.abs(response - response[0]) > max(0.01, SIGNIFICANT * noise)
    return max(0, int(np.argmax(moved)) - 1) if moved.any() else 0


def _window_and_decimation(response: FloatArray, noise: float) -> tuple[int, int]:
    """Return the number of samples to fit and the distance between them.

    The window is some times as long as the response needs to come near its end value. The distance
    is as large as the highest frequency in the response allows.
    """
    final = float(np.mean(response[-max(1, response.size // 20):]))
    away = np.flatnonzero(np.abs(response - final) > max(0.05, 5.0 * noise))
    last = int(away[-1]) + 1 if away.size else 1
    samples = min(response.size, 6 * last + 40)
    spectrum = np.abs(np.fft.rfft(np.diff(response[:samples])))
    frequency = np.arange(spectrum.size) / (samples - 1)  # over the sample rate
    expected = noise * np.sqrt(samples) * 2.0 * np.sin(np.pi * frequency)
    shown = np.flatnonzero(spectrum > np.maximum(5.0 * expected, 0.03 * spectrum.max()))
    highest = frequency[shown[-1]] if shown.size else 1.0 / samples
    every = max(1, min(int(1.0 / (POINTS_PER_CYCLE * max(highest, 1e-9))), samples // 60))
    return min(samples // every, MOST_POINTS), every


def _pencil_poles(values: FloatArray, noise: float) -> ComplexArray:
    """Return the discrete poles inside the unit circle of a sum of exponentials in noise."""
    columns = values.size // 3
    matrix = hankel(values[:values.size - columns], values[values.size - columns - 1:])
    # The constant part is a pole at 1, which differences remove.
    matrix = np.diff(matrix, axis=0)
    _, sizes, right = svd(matrix, full_matrices=False)
    level = SIGNIFICANT * noise * np.sqrt(2.0) * np.sqrt(max(matrix.shape))
    rank = int(np.count_nonzero(sizes > max(level, 1e-6 * sizes[0])))
    basis = right[:max(1, min(rank, 14))].T
    poles = np.linalg.eigvals(lstsq(basis[:-1], basis[1:])[0]).astype(complex)
    # Poles on the negative real axis alternate from sample to sample: noise, not a motion.
    inside = (np.abs(poles) < 1.0) & (np.abs(poles) > 1e-3) & ~(
        (poles.imag == 0.0) & (poles.real < 0.0))
    return poles[inside]
