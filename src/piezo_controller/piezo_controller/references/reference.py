# SPDX-License-Identifier: BSD-3-Clause
"""Reference trajectories of the displacement: one period of samples, or as long as one likes."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from piezo_controller.references.random_trajectory import RandomTrajectory
from piezo_controller.references.raster import fast_axis, flyback_lines, slow_axis
from piezo_controller.references.reference_file import read_samples
from piezo_controller.references.trajectory import FormulaTrajectory
from piezo_controller.references.triangle import triangle_wave

LONGEST_PERIOD_S = 20.0
LONGEST_DURATION_S = 3600.0
LOWEST_FREQUENCY_HZ = 0.001
KINDS = ("harmonic", "multi_frequency", "triangle", "raster", "random", "file")
AXES = ("fast", "slow")


class InvalidReference(ValueError):
    """A reference that has no whole period of samples, or no meaning."""


@dataclass(frozen=True)
class Reference:
    """A trajectory, field by field as in ``piezo_interfaces/Reference``.

    Attributes
    ----------
    kind : str
        ``harmonic``, ``multi_frequency`` (sum of sines, (4.21)), ``triangle``, ``raster``,
        ``random`` or ``file``.
    frequency_hz, amplitude_um, phase_rad : tuple of float
        Of each sine ``amplitude_um / 2 * sin(2 pi frequency_hz t + phase_rad)``; the amplitude is
        peak to peak; a random reference stays within it, and comes close to it now and then. No
        phase means zero. Of a raster the rate of the lines, and the range of the axis; of a random
        reference the edges of its band, the lower one 0 if there is only one. Empty for ``file``.
    centre_um : float
        Mean displacement (um); for ``file`` it is added to the file's displacement.
    file : str
        CSV with the columns ``time_s,displacement_um``: one period at the sample rate.
    once : bool
        A file that is not one period but the whole way; its last value is then held.
    axis : str
        Of a raster: ``fast``, whose lines are straight over the range and turn beyond it, or
        ``slow``, which steps from line to line and flies back after the last.
    lines : int
        Of a raster's frame.
    seed : int
        Of a random reference.
    """

    kind: str
    frequency_hz: tuple = ()
    amplitude_um: tuple = ()
    phase_rad: tuple = ()
    centre_um: float = 0.0
    file: str = ""
    once: bool = False
    axis: str = "fast"
    lines: int = 512
    seed: int = 0


def is_periodic(reference, sample_rate_hz=40000.0):
    """Whether `sample_reference` has a period for it; False for one that has only a way.

    Raises
    ------
    InvalidReference
        If it has no meaning.
    """
    _check_kind(reference)
    if reference.kind == "random":
        return False
    if reference.kind == "file":
        return not reference.once
    if reference.kind == "raster":
        return _frame_samples(reference, sample_rate_hz) <= LONGEST_PERIOD_S * sample_rate_hz
    try:
        _common_period(_components(reference, sample_rate_hz)[0], sample_rate_hz)
    except NoPeriod:
        return False
    return True


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
    _check_kind(reference)
    if reference.kind == "random" or (reference.kind == "file" and reference.once):
        raise InvalidReference(f"a {reference.kind} reference that is not repeated has no period: "
                               "use a mode that streams it")
    if reference.kind == "file":
        return reference.centre_um + _read(reference, sample_rate_hz, LONGEST_PERIOD_S)
    if reference.kind == "raster":
        return _raster(reference, sample_rate_hz,
                       np.arange(_frame_samples(reference, sample_rate_hz)))

    frequencies, amplitudes, phases = _components(reference, sample_rate_hz)
    cycles, length = _common_period(frequencies, sample_rate_hz)
    displacement_um = np.full(length, float(reference.centre_um))
    for cycle, frequency_hz, amplitude_um, phase in zip(cycles, frequencies, amplitudes, phases,
                                                        strict=True):
        turns = (cycle.numerator * (length // cycle.denominator) * np.arange(length)) % length
        angle_rad = 2 * np.pi * turns / length + phase
        displacement_um += amplitude_um / 2 * _SHAPES[reference.kind](angle_rad, frequency_hz)
    return displacement_um


def trajectory(reference, sample_rate_hz=40000.0, watch=None):
    """Make the trajectory of a reference, whether it has a period or not.

    Before its beginning it is what the reference would have been there; of a file that is not
    repeated its first value, and behind it the last.

    Parameters
    ----------
    reference : Reference
    sample_rate_hz : float
    watch : callable, optional
        Called now and then, with the part that is done, while a file is read; may raise.

    Returns
    -------
    Trajectory

    Raises
    ------
    InvalidReference
    """
    _check_kind(reference)
    centre_um = float(reference.centre_um)
    if reference.kind == "random":
        return _random(reference, sample_rate_hz)
    if reference.kind == "file":
        way_um = _read(reference, sample_rate_hz,
                       LONGEST_DURATION_S if reference.once else LONGEST_PERIOD_S, watch)
        last = way_um.size - 1
        return FormulaTrajectory(lambda at: centre_um + way_um[
            np.clip(at, 0, last) if reference.once else at % way_um.size])
    if reference.kind == "raster":
        samples = _frame_samples(reference, sample_rate_hz)
        return FormulaTrajectory(lambda at: _raster(reference, sample_rate_hz, at % samples))
    components = list(zip(*_components(reference, sample_rate_hz), strict=True))

    def formula(at):
        displacement_um = np.full(at.size, centre_um)
        for frequency_hz, amplitude_um, phase in components:
            angle_rad = 2 * np.pi * (at * (frequency_hz / sample_rate_hz) % 1.0) + phase
            displacement_um += amplitude_um / 2 * _SHAPES[reference.kind](angle_rad, frequency_hz)
        return displacement_um

    return FormulaTrajectory(formula)


class NoPeriod(InvalidReference):
    """A reference without a period of whole samples that is short enough to be repeated."""


def _check_kind(reference):
    if reference.kind not in KINDS:
        raise InvalidReference(f"unknown kind of reference {reference.kind!r}: "
                               f'use one of {", ".join(KINDS)}')
    if not math.isfinite(reference.centre_um):
        raise InvalidReference("centre_um of the reference is not a finite number: "
                               "give the mean displacement")


def _common_period(frequencies_hz, sample_rate_hz):
    """Each frequency in cycles per sample, and the samples of the common period."""
    cycles = [_cycles_per_sample(f, sample_rate_hz) for f in frequencies_hz]
    length = math.lcm(*(c.denominator for c in cycles))
    if length > LONGEST_PERIOD_S * sample_rate_hz:
        raise NoPeriod(
            f"the common period of the frequencies is {length / sample_rate_hz:g} s, longer than "
            f"{LONGEST_PERIOD_S:g} s: use multiples of {1 / LONGEST_PERIOD_S:g} Hz")
    return cycles, length


def _read(reference, sample_rate_hz, longest_s, watch=None):
    try:
        return read_samples(reference.file, sample_rate_hz, longest_s, watch)
    except ValueError as error:
        raise InvalidReference(str(error)) from None


def _line_samples(reference, sample_rate_hz):
    (line_rate_hz,), _, _ = _components(reference, sample_rate_hz)
    samples = round(sample_rate_hz / line_rate_hz)
    if abs(samples * line_rate_hz / sample_rate_hz - 1) > 1e-9:
        raise InvalidReference(
            f"a line at {line_rate_hz:.12g} Hz has no whole number of samples: the nearest that "
            f"has is {sample_rate_hz / samples:.12g} Hz")
    if reference.axis not in AXES:
        raise InvalidReference(f"unknown axis {reference.axis!r} of the raster: "
                               f'use one of {", ".join(AXES)}')
    if reference.axis == "slow" and reference.lines < 2:
        raise InvalidReference(f"the raster has {reference.lines} lines: give at least 2")
    return samples


def _frame_samples(reference, sample_rate_hz):
    samples = _line_samples(reference, sample_rate_hz)
    lines = 1 if reference.axis == "fast" else reference.lines + flyback_lines(reference.lines)
    return samples * lines


def _raster(reference, sample_rate_hz, at):
    lines = at / _line_samples(reference, sample_rate_hz)
    shape = fast_axis(lines) if reference.axis == "fast" else slow_axis(lines, reference.lines)
    return reference.centre_um + reference.amplitude_um[0] * shape


def _random(reference, sample_rate_hz):
    edges_hz, amplitude_um = tuple(reference.frequency_hz), tuple(reference.amplitude_um)
    if len(edges_hz) not in (1, 2) or len(amplitude_um) != 1:
        raise InvalidReference("a random reference has one or two frequencies, the edges of its "
                               f"band, and one amplitude, not {len(edges_hz)} and "
                               f"{len(amplitude_um)}: give those")
    low_hz, high_hz = (0.0, *edges_hz)[-2:]
    if not 0 <= low_hz < high_hz < sample_rate_hz / 2:
        raise InvalidReference(f"the band from {low_hz:g} to {high_hz:g} Hz is not between 0 and "
                               f"half the sample rate of {sample_rate_hz:g} Hz: choose one that is")
    if high_hz - low_hz < LOWEST_FREQUENCY_HZ:
        raise InvalidReference(f"the band from {low_hz:g} to {high_hz:g} Hz is narrower than "
                               f"{LOWEST_FREQUENCY_HZ:g} Hz: use a harmonic")
    if not 0 < amplitude_um[0] < math.inf:
        raise InvalidReference(f"amplitude_um {amplitude_um[0]:g} is not a positive number: "
                               "give it from peak to peak")
    if reference.seed < 0:
        raise InvalidReference(f"seed {reference.seed} is negative: give 0 or more")
    return RandomTrajectory(low_hz, high_hz, amplitude_um[0], reference.centre_um, reference.seed,
                            sample_rate_hz)


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
        if not LOWEST_FREQUENCY_HZ <= frequency_hz < sample_rate_hz / 2:
            raise InvalidReference(f"frequency_hz {frequency_hz:g} is not between "
                                   f"{LOWEST_FREQUENCY_HZ:g} Hz and half the "
                                   f"sample rate of {sample_rate_hz:g} Hz: choose one that is")
        if not 0 < amplitude_um < math.inf:
            raise InvalidReference(f"amplitude_um {amplitude_um:g} is not a positive number: "
                                   "give it from peak to peak")
        if not math.isfinite(phase):
            raise InvalidReference("phase_rad of the reference is not a finite number: "
                                   "give one of each per component, or none")
    return frequencies, amplitudes, phases


def _cycles_per_sample(frequency_hz, sample_rate_hz):
    """Return the frequency, in cycles a sample, whose period is short enough to upload."""
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
    raise NoPeriod(
        f"{frequency_hz:.12g} Hz has no period of whole samples within {LONGEST_PERIOD_S:g} s at "
        f"{sample_rate_hz:g} samples a second: the nearest that has is {nearest_hz:.12g} Hz")


def _sine(angle_rad, _frequency_hz):
    return np.sin(angle_rad)


_SHAPES = {"harmonic": _sine, "multi_frequency": _sine, "triangle": triangle_wave}
