# SPDX-License-Identifier: BSD-3-Clause
"""Periodic reference trajectories of the displacement, as one period of samples."""

import csv
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

LONGEST_PERIOD_S = 20.0
TRIANGLE_BANDWIDTH_HZ = 2000.0
KINDS = ("harmonic", "multi_frequency", "triangle", "file")


class InvalidReference(ValueError):
    """A reference that has no whole period of samples, or no meaning."""


@dataclass(frozen=True)
class Reference:
    """A periodic trajectory, field by field as in ``piezo_interfaces/Reference``.

    Attributes
    ----------
    kind : str
        ``harmonic``, ``multi_frequency`` (sum of sines, (4.21)), ``triangle`` or ``file``.
    frequency_hz, amplitude_um, phase_rad : tuple of float
        Of each sine ``amplitude_um / 2 * sin(2 pi frequency_hz t + phase_rad)``; the amplitude is
        peak to peak. No phase means zero. Empty for ``file``.
    centre_um : float
        Mean displacement (um); for ``file`` it is added to the file's displacement.
    file : str
        CSV with the columns ``time_s,displacement_um``: one period at the sample rate.
    """

    kind: str
    frequency_hz: tuple = ()
    amplitude_um: tuple = ()
    phase_rad: tuple = ()
    centre_um: float = 0.0
    file: str = ""


def sample_reference(reference, sample_rate_hz=40000.0):
    """Sample one period of a reference.

    The period is the shortest that holds whole cycles of every component, so that its
    repetition is exactly periodic; a triangle is its Fourier series up to 2 kHz.

    Parameters
    ----------
    reference : Reference
    sample_rate_hz : float

    Returns
    -------
    displacement_um : ndarray, shape (samples per period,)

    Raises
    ------
    InvalidReference
        Says what is wrong; for a frequency without a whole period, names the nearest that has one.
    """
    if reference.kind not in KINDS:
        raise InvalidReference(f"unknown kind of reference {reference.kind!r}: "
                               f'use one of {", ".join(KINDS)}')
    if not math.isfinite(reference.centre_um):
        raise InvalidReference("centre_um of the reference is not a finite number: "
                               "give the mean displacement")
    if reference.kind == "file":
        return reference.centre_um + _read_period(reference.file, sample_rate_hz)

    frequencies, amplitudes, phases = _components(reference, sample_rate_hz)
    cycles = [_cycles_per_sample(f, sample_rate_hz) for f in frequencies]
    length = math.lcm(*(c.denominator for c in cycles))
    if length > LONGEST_PERIOD_S * sample_rate_hz:
        raise InvalidReference(
            f"the common period of the frequencies is {length / sample_rate_hz:g} s, longer than "
            f"{LONGEST_PERIOD_S:g} s: use multiples of {1 / LONGEST_PERIOD_S:g} Hz")
    shape = _triangle if reference.kind == "triangle" else _sine
    displacement_um = np.full(length, float(reference.centre_um))
    for cycle, frequency_hz, amplitude_um, phase in zip(cycles, frequencies, amplitudes, phases,
                                                        strict=True):
        turns = (cycle.numerator * (length // cycle.denominator) * np.arange(length)) % length
        angle_rad = 2 * np.pi * turns / length + phase
        displacement_um += amplitude_um / 2 * shape(angle_rad, frequency_hz)
    return displacement_um


def _components(reference, sample_rate_hz):
    frequencies, amplitudes = reference.frequency_hz, reference.amplitude_um
    phases = reference.phase_rad if len(reference.phase_rad) else (0.0,) * len(frequencies)
    if not len(frequencies) == len(amplitudes) == len(phases) or not len(frequencies):
        raise InvalidReference(
            f"the reference has {len(frequencies)} frequencies, {len(amplitudes)} amplitudes and "
            f"{len(reference.phase_rad)} phases: give one of each per component")
    if reference.kind != "multi_frequency" and len(frequencies) > 1:
        raise InvalidReference(f"a {reference.kind} reference has one frequency, not "
                               f"{len(frequencies)}: use multi_frequency")
    for frequency_hz, amplitude_um, phase in zip(frequencies, amplitudes, phases, strict=True):
        if not 0 < frequency_hz < sample_rate_hz / 2:
            raise InvalidReference(f"frequency_hz {frequency_hz:g} is not between 0 and half the "
                                   f"sample rate of {sample_rate_hz:g} Hz: choose one that is")
        if not 0 < amplitude_um < math.inf:
            raise InvalidReference(f"amplitude_um {amplitude_um:g} is not a positive number: "
                                   "give it from peak to peak")
        if not math.isfinite(phase):
            raise InvalidReference("phase_rad of the reference is not a finite number: "
                                   "give one of each per component, or none")
    return frequencies, amplitudes, phases


def _cycles_per_sample(frequency_hz, sample_rate_hz):
    """The frequency as a fraction of the sample rate with a period short enough to upload."""
    wanted = frequency_hz / sample_rate_hz
    longest = int(LONGEST_PERIOD_S * sample_rate_hz)
    # The continued fraction meets the shortest exact period first.
    for limit in np.unique(np.geomspace(2, longest, 200).astype(int)):
        fraction = Fraction(wanted).limit_denominator(int(limit))
        if abs(float(fraction) - wanted) <= 1e-10 * wanted:
            return fraction
    step_hz = 1 / LONGEST_PERIOD_S
    possible = [max(round(frequency_hz / step_hz), 1) * step_hz,
                sample_rate_hz / min(round(sample_rate_hz / frequency_hz), longest)]
    nearest_hz = min(possible, key=lambda hz: abs(hz - frequency_hz))
    raise InvalidReference(
        f"{frequency_hz:.12g} Hz has no period of whole samples within {LONGEST_PERIOD_S:g} s at "
        f"{sample_rate_hz:g} samples a second: the nearest that has is {nearest_hz:.12g} Hz")


def _sine(angle_rad, _frequency_hz):
    return np.sin(angle_rad)


def _triangle(angle_rad, frequency_hz):
    """Fourier series of a unit triangle: the corners stay within what the stage can follow."""
    orders = np.arange(1, max(TRIANGLE_BANDWIDTH_HZ / frequency_hz, 1) + 1e-9, 2)
    signs = np.where(orders % 4 == 1, 1.0, -1.0)
    wave = np.zeros_like(angle_rad)
    for order, sign in zip(orders, signs, strict=True):
        wave += sign * np.sin(order * angle_rad) / order**2
    return wave / np.sum(1 / orders**2)


def _read_period(path, sample_rate_hz):
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidReference(f"the reference file {path!r} cannot be read: {reason}") from None
    if not rows or [name.strip() for name in rows[0]] != ["time_s", "displacement_um"]:
        raise InvalidReference(f"the reference file {path!r} does not begin with its header: "
                               "make the first line time_s,displacement_um")
    samples = [row for row in rows[1:] if row]
    if not 2 <= len(samples) <= LONGEST_PERIOD_S * sample_rate_hz:
        raise InvalidReference(f"the reference file {path!r} has {len(samples)} samples: give one "
                               f"period of 2 samples to {LONGEST_PERIOD_S:g} s")
    try:
        time_s, displacement_um = np.array(samples, dtype=float).T
    except ValueError:
        raise InvalidReference(f"the reference file {path!r} has a row that is not two numbers: "
                               "give time_s,displacement_um in every row") from None
    if not np.isfinite(displacement_um).all() or not np.isfinite(time_s).all():
        raise InvalidReference(f"the reference file {path!r} holds a value that is not finite: "
                               "remove or replace it")
    expected_s = time_s[0] + np.arange(len(time_s)) / sample_rate_hz
    if np.abs(time_s - expected_s).max() > 0.01 / sample_rate_hz:
        raise InvalidReference(f"the reference file {path!r} is not sampled at "
                               f"{sample_rate_hz:g} Hz: resample it to that rate")
    return displacement_um
