# SPDX-License-Identifier: BSD-3-Clause
"""The lack-of-fit test: a residual beside noise, in single samples and in means of them."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from piezo_common.arrays import FloatArray
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.conditioning.sensor_noise import noise_floor_um


@dataclass(frozen=True)
class LackOfFitSettings:
    """Numbers that steer the test.

    Attributes
    ----------
    significance : float
        Probability at which noise alone is called a lack of fit, for each length of the means.
    growth : int
        Factor between the lengths of the means that are tested.
    fewest_means : int
        Of one length that are tested; fewer tell nothing.
    fewest_at_rest : int
        Samples of a rest that tells the noise.
    at_rest_at_most : float
        Part of a recording that may rest where the rests tell the noise. In a square wave all of it
        rests, so that the rests would hide what the model lacks.
    fewest_for_a_spectrum : int
        Samples from which the noise is taken from the highest frequencies; of fewer, it is taken
        from the second differences of neighbours.
    drift_order : int
        Degree of the polynomial by which repeats, or a rest, may drift.
    tolerance : float
        Part of the travel: a systematic error below it is of no account, as it is lost in rounding,
        in the grid of the density, and in the errors of the other components.
    of_noise : float
        Part of the noise of a sample: a systematic error below it adds an eighth to what a sample
        is off, and many samples show it still.
    """

    significance: float = 1e-4
    growth: int = 4
    fewest_means: int = 24
    fewest_at_rest: int = 200
    at_rest_at_most: float = 0.5
    fewest_for_a_spectrum: int = 1024
    drift_order: int = 2
    tolerance: float = 2e-5
    of_noise: float = 0.5


SETTINGS = LackOfFitSettings()


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """What is left of a recording, beside its noise.

    Parameters
    ----------
    residual_rms_um, noise_rms_um : float
        Of the same samples: of the mean period where the voltage repeats itself.
    systematic_rms_um : float
        What noise does not explain; the largest among the means of different lengths.
    significant : bool
        Noise alone would hardly leave as much.
    noise_from : str
        What told the noise: repeats, rests or the sensor's band.
    sequence_um : ndarray, shape (M,)
        The residual, or its mean period.
    """

    residual_rms_um: float
    noise_rms_um: float
    systematic_rms_um: float
    tolerance_um: float
    significant: bool
    noise_from: str
    sequence_um: FloatArray

    @property
    def ratio(self) -> float:
        """Residual over noise."""
        return self.residual_rms_um / self.noise_rms_um

    @property
    def is_adequate(self) -> bool:
        """Whether what is left is noise, or too little to matter."""
        small_um = max(self.tolerance_um, SETTINGS.of_noise * self.noise_rms_um)
        return not self.significant or self.systematic_rms_um <= small_um


@dataclass(frozen=True, eq=False)
class _Noise:
    """Mean squares of the means of noise, by the samples of each mean, and their freedom."""

    source: str
    mean_squares: dict[int, float]
    freedom: dict[int, float]


def lack_of_fit(residual: ComponentResidual) -> LackOfFit:
    """Test whether a residual is noise.

    Where the voltage repeats itself, the mean period is set against the scatter of the periods, the
    pure error of the classical test (Draper and Smith, Applied Regression Analysis, 1998). Else the
    noise is that of rests, or of the highest frequencies, taken for white. Means over more and more
    samples are tested, in which slow errors stand out of the noise: F is their mean square over
    that of the noise.
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
        means = _means(sequence_um, length)
        square = float(np.mean(means**2))
        largest = f_distribution.isf(SETTINGS.significance, means.size, noise.freedom[length])
        if square > largest * noise_square:
            significant = True
            systematic = max(systematic, square - noise_square)
    return LackOfFit(
        float(np.sqrt(np.mean(sequence_um[residual.good[: sequence_um.size]] ** 2))),
        float(np.sqrt(noise.mean_squares[1])), float(np.sqrt(systematic)),
        SETTINGS.tolerance * float(np.ptp(residual.measured_um[residual.good])), significant,
        noise.source, sequence_um)


def _lengths(samples: int) -> list[int]:
    lengths = [1]
    while samples // (lengths[-1] * SETTINGS.growth) >= SETTINGS.fewest_means:
        lengths.append(lengths[-1] * SETTINGS.growth)
    return lengths


def _means(values: FloatArray, length: int) -> FloatArray:
    """Means of successive samples along the last axis."""
    count = values.shape[-1] // length
    return values[..., : count * length].reshape(*values.shape[:-1], count, length).mean(axis=-1)


def _without_drift(values: FloatArray) -> FloatArray:
    """Each row without its polynomial."""
    basis = np.polynomial.legendre.legvander(
        np.linspace(-1.0, 1.0, values.shape[-1]), SETTINGS.drift_order)
    return values - (basis @ np.linalg.lstsq(basis, values.T, rcond=None)[0]).T


def _of_repeats(folded_um: FloatArray) -> _Noise:
    repeats, period = folded_um.shape
    deviations_um = _without_drift(folded_um - folded_um.mean(axis=0))
    squares: dict[int, float] = {}
    freedom: dict[int, float] = {}
    for length in _lengths(period):
        means = _means(deviations_um, length)
        free = (repeats - 1) * means.shape[-1]
        squares[length] = float(np.sum(means**2)) / free / repeats
        freedom[length] = free
    return _Noise("repeats", _above_rounding(squares, folded_um), freedom)


def _of_rests(residual: ComponentResidual, values_um: FloatArray) -> _Noise | None:
    edges = np.flatnonzero(
        np.diff(residual.voltage_v, prepend=np.nan, append=np.nan) != 0.0)
    longest = int(np.argmax(np.diff(edges)))
    start, end = edges[longest], edges[longest + 1]
    # The first half may still move.
    start += (end - start) // 2
    at_rest = np.sum(np.diff(edges)[np.diff(edges) >= SETTINGS.fewest_at_rest])
    if end - start < SETTINGS.fewest_at_rest or (
            at_rest > SETTINGS.at_rest_at_most * values_um.size):
        return None
    rest_um = _without_drift(values_um[None, start:end])[0]
    squares: dict[int, float] = {}
    freedom: dict[int, float] = {}
    of_rest = _lengths(rest_um.size)
    for length in _lengths(values_um.size):
        known = min(length, of_rest[-1])
        means = _means(rest_um, known)
        squares[length] = float(np.mean(means**2)) * known / length
        freedom[length] = means.size - SETTINGS.drift_order - 1
    return _Noise("rests", _above_rounding(squares, values_um), freedom)


def _of_band(residual: ComponentResidual, values_um: FloatArray) -> _Noise:
    size = values_um.size
    if size >= SETTINGS.fewest_for_a_spectrum:
        noise_um, freedom = noise_floor_um(values_um), size / 8.0
    else:
        # Of white noise, the mean square of the second differences is six times its own.
        noise_um, freedom = np.sqrt(np.mean(np.diff(values_um, 2) ** 2) / 6.0), size / 3
    squares = {length: noise_um**2 / length for length in _lengths(size)}
    return _Noise("the sensor's band", _above_rounding(squares, values_um),
                  dict.fromkeys(squares, float(freedom)))


def _above_rounding(squares: dict[int, float], values_um: FloatArray) -> dict[int, float]:
    """Mean squares that are never zero, as those of simulated data are."""
    least = (np.finfo(float).eps * (np.abs(values_um).max() + np.finfo(float).tiny)) ** 2
    return {length: max(square, least) for length, square in squares.items()}
