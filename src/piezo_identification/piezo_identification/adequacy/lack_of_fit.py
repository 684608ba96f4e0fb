# SPDX-License-Identifier: BSD-3-Clause
"""The lack-of-fit test: compare a residual with noise, in single samples and in their means."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from piezo_common.arrays import FloatArray
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.conditioning.means import block_means
from piezo_identification.conditioning.sensor_noise import SETTINGS as NOISE
from piezo_identification.conditioning.sensor_noise import noise_floor_um, without_drift
from piezo_identification.fitting.regression import SETTINGS as FIT


@dataclass(frozen=True)
class LackOfFitSettings:
    """Settings of the test."""

    significance: float = 1e-4
    """Probability of a false lack of fit from noise alone, for each length of the means."""
    growth: int = 4
    """Factor between the tested lengths of the means."""
    fewest_means: int = 24
    """Fewest means of one length for which that length is tested."""
    at_rest_at_most: float = 0.5
    """Largest fraction of a recording at rest for which the rests give the noise. A square wave
    rests throughout, so its rests would hide the errors of the model."""
    fewest_for_a_spectrum: int = 1024
    """Fewest samples for which the noise is estimated from the highest frequencies; below it,
    second differences are used."""
    of_noise: float = 0.5
    """Fraction of the noise of a sample below which a systematic error is negligible. It adds an
    eighth to the RMS error of a sample, although it may be significant."""


SETTINGS = LackOfFitSettings()


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """The residual on a recording compared with the noise."""

    residual_rms_um: float
    noise_rms_um: float
    """RMS of residual and noise in the same samples; of the mean period if the voltage is
    periodic."""
    systematic_rms_um: float
    """RMS of the residual beyond the noise: the largest for the tested lengths of the means."""
    tolerance_um: float

    significant: bool
    """Whether noise alone is very unlikely to give this residual."""
    noise_from: str
    """Source of the noise estimate: repeats, rests or the sensor's band."""
    sequence_um: FloatArray
    """The residual, or its mean period, (M,)."""

    @property
    def ratio(self) -> float:
        """Residual over noise; 1 if there is neither."""
        least_um = np.finfo(float).eps * self.residual_rms_um
        return self.residual_rms_um / max(self.noise_rms_um, least_um) if least_um > 0.0 else 1.0

    @property
    def is_adequate(self) -> bool:
        """Whether the residual is noise, or negligible."""
        small_um = max(self.tolerance_um, SETTINGS.of_noise * self.noise_rms_um)
        return not self.significant or self.systematic_rms_um <= small_um


@dataclass(frozen=True, eq=False)
class _Noise:
    """Mean squares of means of the noise and their degrees of freedom, by length of the means."""

    source: str
    mean_squares: dict[int, float]
    freedom: dict[int, float]


def lack_of_fit(residual: ComponentResidual) -> LackOfFit:
    """Test whether a residual is noise.

    For a periodic voltage, the mean period is compared with the scatter of the periods, the pure
    error of the classical test (Draper and Smith, Applied Regression Analysis, 1998). Otherwise,
    the noise is estimated from rests, or from the highest frequencies and assumed to be white.
    Means over increasing numbers of samples are tested, in which slow errors exceed the noise. F is
    their mean square over that of the noise.
    """
    values_um = np.where(residual.good, residual.residual_um, 0.0)
    period = residual.period or values_um.size
    repeats = values_um.size // period
    if repeats >= 2:
        folded_um = values_um[: repeats * period].reshape(repeats, -1)
        sequence_um = folded_um.mean(axis=0)
        noise = _of_repeats(folded_um)
    else:
        sequence_um = values_um
        noise = _of_rests(residual, values_um) or _of_band(residual, values_um)
    systematic, significant = 0.0, False
    for length, noise_square in noise.mean_squares.items():
        means = block_means(sequence_um, length)
        square = float(np.mean(means**2))
        largest = f_distribution.isf(SETTINGS.significance, means.size, noise.freedom[length])
        if square > largest * noise_square:
            significant = True
            systematic = max(systematic, square - noise_square)
    return LackOfFit(
        float(np.sqrt(np.mean(sequence_um[residual.good[: sequence_um.size]] ** 2))),
        float(np.sqrt(noise.mean_squares[1])), float(np.sqrt(systematic)),
        FIT.adequate_tolerance * float(np.ptp(residual.measured_um[residual.good])), significant,
        noise.source, sequence_um)


def _lengths(samples: int) -> list[int]:
    lengths = [1]
    while samples // (lengths[-1] * SETTINGS.growth) >= SETTINGS.fewest_means:
        lengths.append(lengths[-1] * SETTINGS.growth)
    return lengths


def _of_repeats(folded_um: FloatArray) -> _Noise:
    repeats, period = folded_um.shape
    deviations_um = without_drift(folded_um - folded_um.mean(axis=0))
    squares: dict[int, float] = {}
    freedom: dict[int, float] = {}
    for length in _lengths(period):
        means = block_means(deviations_um, length)
        free = (repeats - 1) * means.shape[-1]
        squares[length] = float(np.sum(means**2)) / free / repeats
        freedom[length] = free
    return _Noise("repeats", _above_rounding(squares, folded_um), freedom)


def _of_rests(residual: ComponentResidual, values_um: FloatArray) -> _Noise | None:
    edges = np.flatnonzero(
        np.diff(residual.voltage_v, prepend=np.nan, append=np.nan) != 0.0)
    longest = int(np.argmax(np.diff(edges)))
    start, end = edges[longest], edges[longest + 1]
    # The stage may still settle in the first half.
    start += (end - start) // 2
    at_rest = np.sum(np.diff(edges)[np.diff(edges) >= NOISE.fewest_at_rest])
    if end - start < NOISE.fewest_at_rest or (
            at_rest > SETTINGS.at_rest_at_most * values_um.size):
        return None
    rest_um = without_drift(values_um[None, start:end])[0]
    squares: dict[int, float] = {}
    freedom: dict[int, float] = {}
    of_rest = _lengths(rest_um.size)
    for length in _lengths(values_um.size):
        known = min(length, of_rest[-1])
        means = block_means(rest_um, known)
        squares[length] = float(np.mean(means**2)) * known / length
        freedom[length] = means.size - NOISE.drift_order - 1
    return _Noise("rests", _above_rounding(squares, values_um), freedom)


def _of_band(residual: ComponentResidual, values_um: FloatArray) -> _Noise:
    size = values_um.size
    if size >= SETTINGS.fewest_for_a_spectrum:
        noise_um, freedom = noise_floor_um(values_um), size / 8.0
    else:
        # For white noise, second differences have six times its mean square.
        noise_um, freedom = np.sqrt(np.mean(np.diff(values_um, 2) ** 2) / 6.0), size / 3
    squares = {length: noise_um**2 / length for length in _lengths(size)}
    return _Noise("the sensor's band", _above_rounding(squares, values_um),
                  dict.fromkeys(squares, float(freedom)))


def _above_rounding(squares: dict[int, float], values_um: FloatArray) -> dict[int, float]:
    """Return mean squares of at least the rounding error; those of simulated data may be 0."""
    least = (np.finfo(float).eps * (np.abs(values_um).max() + np.finfo(float).tiny)) ** 2
    return {length: max(square, least) for length, square in squares.items()}
