# SPDX-License-Identifier: BSD-3-Clause
"""Common to all kinds of references: the fields, and the interface that the controller uses."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from piezo_common.arrays import FloatArray
from piezo_controller.references.trajectory import FormulaTrajectory, Trajectory

LONGEST_PERIOD_S = 20.0
LONGEST_DURATION_S = 3600.0
LOWEST_FREQUENCY_HZ = 0.001

Watch = Callable[[float], None]
"""Called from time to time with the fraction done (0 to 1); may raise to end the work."""

Components = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]


class InvalidReference(ValueError):
    """A reference that has no period of whole samples, or whose fields make no sense."""


class NoPeriod(InvalidReference):
    """A reference without a period of whole samples that is short enough to be repeated."""


@dataclass(frozen=True)
class Reference:
    """A trajectory, field by field as in ``piezo_interfaces/Reference``."""

    kind: str
    """``harmonic``, ``multi_frequency`` (sum of sines, (4.21)), ``triangle``, ``raster``,
    ``random`` or ``file``, or a kind of another package."""
    frequency_hz: tuple[float, ...] = ()
    amplitude_um: tuple[float, ...] = ()
    phase_rad: tuple[float, ...] = ()
    """Frequency, peak-to-peak amplitude and phase (0 if omitted) of each sine ``amplitude_um / 2 *
    sin(2 pi frequency_hz t + phase_rad)``. For a raster the line rate and the range of the axis.
    For a random reference the edges of its band (the lower one is 0 if only one is given) and its
    range, which it approaches but never exceeds. Empty for ``file``."""
    centre_um: float = 0.0
    """Mean displacement (um); for ``file`` it is added to the file's displacement."""
    file: str = ""
    """CSV with the columns ``time_s,displacement_um``: one period at the sample rate."""
    once: bool = False
    """Whether a file is the whole trajectory rather than one period; its last value is then
    held."""
    axis: str = "fast"
    """Axis of a raster: ``fast``, whose lines are straight over the range and turn beyond it, or
    ``slow``, which steps from line to line and flies back after the last."""
    lines: int = 512
    """Number of lines in a frame of a raster."""
    seed: int = 0
    """Seed of a random reference."""


class ReferenceKind(Protocol):
    """The interface of a kind of reference.

    Displacements (um) contain the reference's `centre_um`, which is finite. Each method raises
    `InvalidReference` if the fields of the reference make no sense for the kind.
    """

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return whether `period_um` has a period for this reference."""

    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Sample one period, shape (P,); its repetition must be exactly periodic."""

    def trajectory(self, reference: Reference, sample_rate_hz: float,
                   watch: Watch) -> Trajectory:
        """Return the trajectory, which can be sampled anywhere, also before its beginning."""


class PeriodicKind(ABC):
    """Base of the kinds that always have a period: such a kind needs to define only `period_um`."""

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return whether the period is short enough to be uploaded."""
        return len(self.period_um(reference, sample_rate_hz)) <= LONGEST_PERIOD_S * sample_rate_hz

    @abstractmethod
    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Sample one period, shape (P,)."""

    def trajectory(self, reference: Reference, sample_rate_hz: float, watch: Watch) -> Trajectory:
        """Return the repeated period, also before the beginning."""
        period_um = self.period_um(reference, sample_rate_hz)
        return FormulaTrajectory(lambda at: period_um[at % len(period_um)])


def one_component(reference: Reference, sample_rate_hz: float) -> tuple[float, float, float]:
    """Check a reference of one frequency, and return its frequency, amplitude and phase.

    Raises `InvalidReference` as `components`, and if it has more than one frequency.
    """
    frequencies_hz, amplitudes_um, phases_rad = components(reference, sample_rate_hz, most=1)
    return frequencies_hz[0], amplitudes_um[0], phases_rad[0]


def components(reference: Reference, sample_rate_hz: float,
               most: float = math.inf) -> Components:
    """Check the components of a reference; return their frequencies, amplitudes and phases.

    Phases that are not given are zero. Raises `InvalidReference` if their numbers differ or exceed
    `most`, a frequency is not between 0.001 Hz and half the sample rate, an amplitude is not
    positive, or a phase is not finite.
    """
    frequencies, amplitudes = reference.frequency_hz, reference.amplitude_um
    phases = reference.phase_rad if len(reference.phase_rad) else (0.0,) * len(frequencies)
    if not len(frequencies) == len(amplitudes) == len(phases) or not len(frequencies):
        raise InvalidReference(
            f"the reference has {len(frequencies)} frequencies, {len(amplitudes)} amplitudes and "
            f"{len(reference.phase_rad)} phases: give one of each per component")
    if len(frequencies) > most:
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
