# SPDX-License-Identifier: BSD-3-Clause
"""A path of several axes: one period of positions at the sample rate, with its marks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import InvalidReference

MOST_SAMPLES = 2_500_000
"""Samples of a period: a frame of a minute at 40 kHz. A plan keeps ten arrays of them or so."""


@dataclass(frozen=True, eq=False)
class ScanPath:
    """One period of a path; the sample after the last is the first again.

    Raises `InvalidReference` if positions and axes do not fit, or the period is too short or too
    long.
    """

    kind: str
    """Name of its pattern, such as ``raster``."""
    axes: tuple[str, ...]
    """That it moves."""
    sample_period_s: float

    position_um: FloatArray
    """Shape (N, m)."""
    marks: NDArray[np.int64]
    """Bits of `Mark`, (N,)."""
    rate_hz: float
    """Lines, turns, points or periods a second, as the kind counts them."""
    size_um: FloatArray
    """Size of the image along each axis, (m,); turns go beyond it."""
    centre_um: FloatArray
    """Shape (m,)."""

    def __post_init__(self) -> None:
        if self.position_um.ndim != 2 or self.position_um.shape[1] != len(self.axes):
            raise InvalidReference(f"the path has positions of the shape {self.position_um.shape}: "
                                   f"give a column for each of {', '.join(self.axes)}")
        check_length(len(self.position_um), self.sample_period_s)
        if not np.isfinite(self.position_um).all():
            raise InvalidReference("the path has a position that is not finite: mend it or cut it "
                                   "out")

    def __str__(self) -> str:
        return f"{self.kind} of {size_text(self.size_um)} at {self.rate_hz:.6g} Hz"

    @property
    def time_s(self) -> FloatArray:
        """Return the times of the samples, shape (N,)."""
        return self.sample_period_s * np.arange(len(self.position_um), dtype=float)

    def scaled(self, scale: float) -> "ScanPath":
        """Return the path of another size about the same centre."""
        return replace(self, size_um=scale * self.size_um,
                       position_um=self.centre_um + scale * (self.position_um - self.centre_um))

    def slower(self, samples: int) -> "ScanPath":
        """Return the same path in more samples; what is between them follows its Fourier series."""
        before = len(self.position_um)
        marks = np.zeros(samples, dtype=int)
        marked = np.flatnonzero(self.marks)
        marks[marked * samples // before] = self.marks[marked]
        return replace(self, position_um=resample(self.position_um, samples), marks=marks,
                       rate_hz=self.rate_hz * before / samples)


def check_length(samples: float, sample_period_s: float) -> None:
    """Raise `InvalidReference` if a period has too few or too many samples."""
    if not 4 <= samples <= MOST_SAMPLES:
        raise InvalidReference(
            f"the path takes {samples * sample_period_s:.4g} s, {samples:.0f} samples: change its "
            f"rate or lines such that it has 4 to {MOST_SAMPLES}")


def size_text(size_um: FloatArray) -> str:
    """Return a size such as ``20 x 20 um``."""
    return " x ".join(f"{each:.4g}" for each in size_um) + " um"
