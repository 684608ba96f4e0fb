# SPDX-License-Identifier: BSD-3-Clause
"""Spectra of recordings of several axes at the excited lines."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.axes.axes_response import AxesResponse
from piezo_identification.axes.predict_axes import mean_period
from piezo_identification.estimators.frequency_response.response_search import weight_of_noise
from piezo_recorder.reading.axes import AxesRecording

SMOOTHED_LINES = 31
"""Lines over which a spectral density is averaged. The scatter of six realisations of three axes is
then known to 10 %; a mode with a damping ratio of 1 % is about as wide at 1 s of recording."""

FLOOR_LINES = 101
"""Lines most of which lie beside a resonance that is some lines wide."""

SAME_LEVEL = 1.1
"""Ratio of amplitudes up to which recordings are of one level: the gain of an actuator changes by a
few percent over it."""

EXCITED = 1e-2
"""Part of the largest line's voltage above which a line of a periodic voltage is played."""


LOCAL_DEGREE, LOCAL_FREEDOM = 2, 8
"""Degree of the polynomials that follow responses over neighbouring lines, the least that follows a
bend, and lines beyond those that they take; the scatter of eight is known to a third."""

MOST_LINES = 20_000
"""Lines of a recording that are fitted, those of the largest drive: more take memory, and of a slow
recording they show the noise alone."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Drive and motion at lines, of a recording or of the response of a level to one axis."""

    z: ComplexArray
    """On the unit circle, (K,): what turns a signal by a sample period."""
    drive: ComplexArray
    motion: ComplexArray
    """Shape (K, n)."""
    weight: FloatArray
    """One over the standard deviation of each motion, (K, n)."""
    amplitude_v: float
    """RMS of all voltages in the time domain."""
    transient: bool
    """The recording neither begins nor ends at rest, nor does it repeat."""
    ahead: int = 0
    """Samples by which a motion was advanced at most: so many of its begin stand at its end."""

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the axes that are driven."""
        return tuple(np.flatnonzero(np.any(self.drive != 0.0, axis=0)))

    def advanced(self, samples: np.ndarray) -> "Spectrum":
        """Return the spectrum with each sensor's latency taken off, in samples."""
        return replace(self, motion=self.motion * self.z[:, None] ** samples,
                       ahead=int(np.max(samples)))


def levels_of(recordings: Sequence[AxesRecording]) -> list[list[AxesRecording]]:
    """Return the recordings by level of amplitude, rising."""
    rising = sorted(recordings, key=lambda each: each.amplitude_v)
    levels: list[list[AxesRecording]] = []
    for recording in rising:
        if levels and recording.amplitude_v <= SAME_LEVEL * levels[-1][0].amplitude_v:
            levels[-1].append(recording)
        else:
            levels.append([recording])
    return levels


def spectra_of_levels(recordings: Sequence[AxesRecording]) -> list[list[Spectrum]]:
    """Return the spectra of recordings by level of amplitude, rising."""
    return [spectra_of_level(level) for level in levels_of(recordings)]


def spectra_of_level(recordings: Sequence[AxesRecording]) -> list[Spectrum]:
    """Return the spectra of recordings of one level.

    Where there are more realisations of equal periods than axes, it is the best linear
    approximation, with the scatter of the realisations about it, noise and distortion alike, as
    its deviation (Pintelon and Schoukens, "System Identification", 2012, section 7.3.6). Else it
    is the spectrum of each recording.
    """
    first, n = recordings[0], len(recordings[0].axes)
    alike = all(each.periods and each.periods == first.periods
                and each.voltage_v.shape == first.voltage_v.shape for each in recordings)
    if alike and len(recordings) > n:
        return _linear_approximation(recordings)
    return [spectrum_of(each) for each in recordings]


def spectra_of_response(response: AxesResponse) -> list[Spectrum]:
    """Return the spectrum of a measured response to each axis, as of held voltage samples.

    Deviations that are not known are alike at all lines, as large as most lines' rough part. Raise
    ValueError if the sample rate is too low for the frequencies.
    """
    held = response.hold_gain()[:, None, None]
    z = np.exp(2j * np.pi * response.frequency_hz * response.sample_period_s)
    deviation = response.known_deviation()
    known = np.ones_like(response.gain_um_per_v) if deviation is None else deviation
    weight = 1.0 / np.abs(held * known)
    spectra = [response_to(axis, z, (held * response.gain_um_per_v)[:, :, axis],
                           weight[:, :, axis], amplitude_v=1.0)
               for axis in range(len(response.axes))]
    if deviation is None:
        rough = [np.maximum(np.median(np.abs(_rough_part(each)), axis=0), _rounding(each))
                 for each in spectra]
        return [replace(each, weight=np.ones(each.weight.shape) / typical)
                for each, typical in zip(spectra, rough, strict=True)]
    return spectra


def with_rough_deviations(response: AxesResponse) -> list[Spectrum]:
    """Return the spectra of a response with their deviations, or with what neighbouring lines show.

    Near a resonance that is only some lines wide, these are larger than the noise.
    """
    spectra = spectra_of_response(response)
    if response.known_deviation() is not None:
        return spectra
    return [reweighted(each, np.maximum(np.abs(_rough_part(each)), _rounding(each)))
            for each in spectra]


def weight_by_residual(response: Spectrum, left: ComplexArray) -> FloatArray:
    """Return the weights of a response by what a fit leaves: a constant and a relative part."""
    weight = np.column_stack([weight_of_noise(*each) for each in zip(
        left.T, (response.motion - left).T, strict=True)])
    scaled: FloatArray = weight / np.sqrt(np.mean(np.abs(weight * left) ** 2, axis=0))
    return scaled


def _rounding(response: Spectrum) -> float:
    """Return a deviation for what is zero at all lines, as the motion of an axis not coupled."""
    return float(np.sqrt(np.finfo(float).eps) * np.abs(response.motion).max())


def response_to(axis: int, z: ComplexArray, motion: ComplexArray, weight: FloatArray,
                 amplitude_v: float) -> Spectrum:
    """Return the response to one axis as the motion under a drive of 1."""
    drive = np.tile(np.eye(motion.shape[1])[axis], (z.size, 1)).astype(complex)
    return Spectrum(z, drive, motion, weight, amplitude_v, transient=False)


def smoothed(power: FloatArray) -> FloatArray:
    """Return a density averaged over neighbouring lines, shape as given, lines first."""
    lines = min(SMOOTHED_LINES, len(power))
    averaged: FloatArray = uniform_filter1d(power, lines, axis=0, mode="nearest")
    return averaged


def reweighted(spectrum: Spectrum, residual: ComplexArray) -> Spectrum:
    """Return a spectrum whose deviations are the residual of a fit, shape (K, n)."""
    deviation = np.sqrt(smoothed(np.abs(residual) ** 2))
    return replace(spectrum, weight=1.0 / np.maximum(deviation, np.finfo(float).tiny))


def beside_resonances(spectrum: Spectrum, residual: ComplexArray) -> Spectrum:
    """Return a spectrum whose deviations are the residual of a fit beside narrow resonances."""
    square = median_filter(np.abs(residual) ** 2, (min(FLOOR_LINES, len(residual)), 1),
                           mode="nearest")
    return replace(spectrum, weight=1.0 / np.sqrt(np.maximum(square, np.finfo(float).tiny)))


def spectrum_of(recording: AxesRecording) -> Spectrum:
    """Return the spectrum of a recording, with the deviations that neighbouring lines show."""
    z, _, (drive, motion) = _lines(recording)
    drive, motion = drive.mean(axis=0), motion.mean(axis=0)
    kept = np.sort(np.argsort(np.linalg.norm(drive, axis=1))[-MOST_LINES:])
    spectrum = Spectrum(
        z[kept], drive[kept], motion[kept], np.ones((kept.size, motion.shape[1])),
        recording.amplitude_v, transient=not recording.periods)
    return reweighted(spectrum, _rough_part(spectrum))


def driven_otherwise(spectrum: Spectrum, recording: AxesRecording) -> Spectrum:
    """Return the spectrum of a recording with the drive of another one of the same samples."""
    drive_v = mean_period(recording, recording.voltage_v)
    lines = np.round(np.angle(spectrum.z) * len(drive_v) / (2.0 * np.pi)).astype(int)
    return replace(spectrum, drive=np.fft.rfft(drive_v, axis=0)[lines])


def _rough_part(spectrum: Spectrum) -> ComplexArray:
    """Return what is not smooth over a few lines of responses and transient, shape (K, n).

    This is the local polynomial method (Pintelon and Schoukens, "System Identification", 2012,
    section 7.2.2), scaled to the size of the noise.
    """
    drive = spectrum.drive[:, list(spectrum.driven)]
    if spectrum.transient:
        drive = np.column_stack([drive, np.ones(len(drive))])
    numbers = (LOCAL_DEGREE + 1) * drive.shape[1]
    lines = numbers + LOCAL_FREEDOM
    if len(drive) < lines:
        return spectrum.motion
    first = np.clip(np.arange(len(drive)) - lines // 2, 0, len(drive) - lines)
    local = first[:, None] + np.arange(lines)
    away = ((local - np.arange(len(drive))[:, None]) / lines)[:, :, None]
    columns = np.concatenate([drive[local] * away**degree for degree in range(LOCAL_DEGREE + 1)],
                             axis=2)
    orthogonal = np.linalg.qr(columns)[0]
    motion = spectrum.motion[local]
    residual = motion - orthogonal @ (orthogonal.conj().transpose(0, 2, 1) @ motion)
    rough: ComplexArray = np.sqrt(np.sum(np.abs(residual) ** 2, axis=1) / LOCAL_FREEDOM) + 0j
    return rough


def _lines(recording: AxesRecording) -> tuple[ComplexArray, np.ndarray, list[ComplexArray]]:
    """Return z, numbers of lines, and drive and motion of each period, (P, K, n)."""
    periods = recording.periods or 1
    samples = len(recording.voltage_v) // periods
    spectra = [np.fft.rfft(signal.reshape(periods, samples, -1), axis=1)
               for signal in (recording.voltage_v, recording.displacement_um)]
    lines = np.arange(1, (samples + 1) // 2)
    if recording.periods:
        lines = lines[played_lines(spectra[0].mean(axis=0))[lines]]
    return np.exp(2j * np.pi * lines / samples), lines, [each[:, lines] for each in spectra]


def played_lines(voltage: ComplexArray) -> BoolArray:
    """Return which lines of the spectrum of a periodic voltage, (K, n), are played; 0 is not."""
    size = np.abs(voltage).max(axis=1)
    size[0] = 0.0
    played: BoolArray = size > EXCITED * size.max()
    return played


def _linear_approximation(recordings: Sequence[AxesRecording]) -> list[Spectrum]:
    found = [_lines(each) for each in recordings]
    common = set.intersection(*(set(lines.tolist()) for _, lines, _ in found))
    kept = [np.isin(lines, sorted(common)) for _, lines, _ in found]
    z = found[0][0][kept[0]]
    # Lines, axes, realisations.
    drive = np.stack([each[0].mean(axis=0)[keep] for (_, _, each), keep in zip(
        found, kept, strict=True)], axis=-1)
    motion = np.stack([each[1].mean(axis=0)[keep] for (_, _, each), keep in zip(
        found, kept, strict=True)], axis=-1)
    periods = recordings[0].periods
    noise = np.zeros(motion.shape)
    if periods > 1:
        noise = smoothed(np.stack([
            np.var(each[1][:, keep], axis=0, ddof=1) / periods
            for (_, _, each), keep in zip(found, kept, strict=True)], axis=-1))
    realisations, n = len(recordings), drive.shape[1]
    weight = np.ones(motion.shape)
    for _ in range(2):  # the second time, noisy realisations count less
        gain, inverse = _weighted_gain(drive, motion, weight)
        residual = np.abs(motion - gain @ drive) ** 2 * (realisations / (realisations - n))
        distortion = np.maximum(smoothed(np.mean(residual, axis=2) - np.mean(noise, axis=2)),
                                smoothed(np.mean(residual, axis=2)) / realisations)
        weight = 1.0 / np.sqrt(distortion[:, :, None] + noise)
    gain, inverse = _weighted_gain(drive, motion, weight)
    amplitude_v = float(np.mean([each.amplitude_v for each in recordings]))
    deviation = np.sqrt(np.einsum("kijj->kij", inverse).real)
    return [response_to(axis, z, gain[:, :, axis], 1.0 / deviation[:, :, axis], amplitude_v)
            for axis in range(n)]


def _weighted_gain(drive: ComplexArray, motion: ComplexArray, weight: FloatArray,
                   ) -> tuple[ComplexArray, ComplexArray]:
    """Return gain (K, n, n) and its covariance over the driven axes, (K, n, n, n)."""
    square = weight**2
    products = np.einsum("kar,kir,kbr->kiab", drive.conj(), square, drive)
    targets = np.einsum("kar,kir,kir->kia", drive.conj(), square, motion)
    inverse = np.linalg.inv(products)
    return np.einsum("kiab,kib->kia", inverse, targets), inverse
