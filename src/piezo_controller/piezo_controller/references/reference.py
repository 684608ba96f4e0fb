# SPDX-License-Identifier: BSD-3-Clause
"""Reference trajectories of the displacement: one period of samples, or of unlimited duration.

A kind of reference is one module here and one line of `KINDS`. A package of its own adds one
through an entry point of the group `piezo_controller.references`.
"""

import math

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.registered import registered
from piezo_controller.references.kind import (
    LONGEST_DURATION_S,
    LONGEST_PERIOD_S,
    InvalidReference,
    NoPeriod,
    Reference,
    ReferenceKind,
    Watch,
)
from piezo_controller.references.random_trajectory import RandomKind
from piezo_controller.references.raster import Raster
from piezo_controller.references.reference_file import FileKind
from piezo_controller.references.sines import HARMONIC, MULTI_FREQUENCY, TRIANGLE
from piezo_controller.references.trajectory import Trajectory

__all__ = [
    "GROUP", "KINDS", "LONGEST_DURATION_S", "InvalidReference", "NoPeriod", "Reference",
    "is_periodic", "sample_reference", "trajectory",
]

GROUP = "piezo_controller.references"
"""Group of entry points by which other packages add kinds of references."""

KINDS: dict[str, ReferenceKind] = {
    "harmonic": HARMONIC,
    "multi_frequency": MULTI_FREQUENCY,
    "triangle": TRIANGLE,
    "raster": Raster(),
    "random": RandomKind(),
    "file": FileKind(),
}
"""Kinds that come with this package."""


def is_periodic(reference: Reference, sample_rate_hz: float = 40000.0) -> bool:
    """Return whether `sample_reference` has a period for a reference; raise `InvalidReference`."""
    return _kind(reference).is_periodic(reference, sample_rate_hz)


def sample_reference(reference: Reference,
                     sample_rate_hz: float = 40000.0) -> FloatArray:
    """Sample one period of a reference, shape (samples per period,).

    The period is the shortest that holds whole cycles of every component, so that its repetition is
    exactly periodic; a triangle is its Fourier series up to 2 kHz. Raises `InvalidReference`, which
    names the cause; for a frequency without a whole period, the nearest with one.
    """
    period_um = _checked(_kind(reference).period_um(reference, sample_rate_hz), reference)
    if not 2 <= period_um.size <= LONGEST_PERIOD_S * sample_rate_hz:
        raise InvalidReference(f"the {reference.kind} reference has a period of {period_um.size} "
                               f"samples: give one of 2 samples to {LONGEST_PERIOD_S:g} s")
    return period_um


def trajectory(reference: Reference, sample_rate_hz: float = 40000.0,
               watch: Watch | None = None) -> Trajectory:
    """Return the trajectory of a reference, with or without a period.

    It is also defined before its beginning. A file that is not repeated rests at its first value
    before, and at its last value after. Sampling it raises `InvalidReference` if a kind of another
    package gives displacements that are not finite. `watch` is called while a file is read.
    """
    made = _kind(reference).trajectory(reference, sample_rate_hz, watch or (lambda fraction: None))
    return _CheckedTrajectory(made, reference)


def _kind(reference: Reference) -> ReferenceKind:
    try:
        known = registered(GROUP, KINDS)
        if reference.kind not in known:
            raise InvalidReference(f"unknown kind of reference {reference.kind!r}: "
                                   f'use one of {", ".join(known)}')
        kind = known[reference.kind]
    except ValueError as error:
        raise InvalidReference(str(error)) from None
    if not math.isfinite(reference.centre_um):
        raise InvalidReference("centre_um of the reference is not a finite number: "
                               "give the mean displacement")
    return kind


class _CheckedTrajectory(Trajectory):
    """A trajectory whose displacements are checked to be finite and as many as requested."""

    def __init__(self, trajectory: Trajectory, reference: Reference) -> None:
        self._trajectory, self._reference = trajectory, reference

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        displacement_um = _checked(self._trajectory.sample(first, count), self._reference)
        if displacement_um.size != count:
            raise InvalidReference(f"the {self._reference.kind} reference gives "
                                   f"{displacement_um.size} samples in place of {count}: "
                                   "mend the package of this kind")
        return displacement_um

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`."""
        return _checked(self._trajectory.survey(samples), self._reference)


def _checked(displacement_um: FloatArray, reference: Reference) -> FloatArray:
    if np.ndim(displacement_um) != 1 or not np.isfinite(displacement_um).all():
        raise InvalidReference(f"the {reference.kind} reference is not one sequence of finite "
                               "displacements: mend its fields, or the package of this kind")
    return np.asarray(displacement_um, dtype=float)
