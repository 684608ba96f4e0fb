# SPDX-License-Identifier: BSD-3-Clause
"""Inverse of the linear dynamics for periodic references."""

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray, FloatArray, IntArray
from piezo_models.linear.dynamics import zoh_response

NEGLIGIBLE_CONTENT = 1e-12
"""Harmonics below this fraction of the largest one are rounding errors of the Fourier
transform."""
SMALLEST_GAIN = 1e-6
"""The reference is rejected if it has a harmonic at which the gain is below this fraction of
the DC gain: the inverse would amplify its rounding error more than a million times."""


def used_lines(lines: ComplexArray) -> IntArray:
    """Return the lines of a spectrum, (F,) or (F, axes), whose content is not negligible."""
    size = np.abs(lines).reshape(len(lines), -1).max(axis=1)
    return np.flatnonzero(size > NEGLIGIBLE_CONTENT * size.max())


def invert_linear_periodic(reference_um: ArrayLike, system: control.StateSpace,
                           sample_period_s: float, dc_gain: float | None = None) -> FloatArray:
    """Return one period of the input whose steady output, held and sampled, is the reference.

    Each harmonic of the Fourier series is divided by the response of the ZOH-sampled system,
    eq. (4.22) with the sampled in place of the continuous response, so the inverse is exact.

    Parameters
    ----------
    reference_um : (N,) array_like
        One period of the reference.
    system : control.StateSpace
        Continuous system with one input and one output.
    dc_gain : float, optional
        Gain for the mean of the reference while creep continues; that of the system by default.

    Raises
    ------
    ValueError
        If the reference is not finite, or has content where the system has almost no gain.

    Examples
    --------
    >>> import control
    >>> from piezo_models import simulate_linear, zoh
    >>> lag = control.ss(-100.0, 100.0, 1.0, 0.0)
    >>> reference_um = 5.0 + np.sin(2.0 * np.pi * np.arange(50) / 50)
    >>> voltage_v = invert_linear_periodic(reference_um, lag, 1e-3)
    >>> settled_um = simulate_linear(zoh(lag, 1e-3), np.tile(voltage_v, 10))[-50:]
    >>> bool(np.abs(settled_um - reference_um).max() < 1e-9)
    True
    """
    reference = np.asarray(reference_um, dtype=float)
    if reference.ndim != 1 or reference.size == 0:
        raise ValueError("the reference must be one period, a non-empty sequence")
    if not np.isfinite(reference).all():
        raise ValueError("the reference holds a value that is not finite; remove or replace it")
    harmonics = np.fft.rfft(reference)
    used = used_lines(harmonics)
    frequency_hz = used / (reference.size * sample_period_s)
    response = zoh_response(system, frequency_hz, sample_period_s)
    gain = np.abs(response)
    static_gain = float(np.real(zoh_response(system, 0.0, sample_period_s)))
    lost = gain < SMALLEST_GAIN * abs(static_gain)
    if lost.any():
        raise ValueError(
            f"the reference has content at {frequency_hz[lost][0]:.6g} Hz, where the system passes "
            f"less than {SMALLEST_GAIN:g} of its DC gain; smooth the reference"
        )
    if dc_gain is not None:
        response = np.where(used == 0, dc_gain, response)
    inverse = np.zeros_like(harmonics)
    inverse[used] = harmonics[used] / response
    return np.fft.irfft(inverse, reference.size)
