# SPDX-License-Identifier: BSD-3-Clause
"""The numbers of hysteresis and creep of several axes as a fit takes them."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray, IntArray
from piezo_identification.axes.spectra import Spectrum

USUAL_CREEP = 0.1
"""Width of the prior of a gain, several times that by which piezo ceramics creep in two decades of
time (1 to 2 % a decade, as makers tell). Without it, fast creep and hysteresis make up for each
other without end."""


def _none() -> FloatArray:
    return np.zeros(0)


def _no_axes() -> IntArray:
    return np.zeros(0, dtype=int)


@dataclass(frozen=True, eq=False)
class ActuatorNumbers:
    """Changes of the hysteresis of each axis, and its creep.

    Attributes
    ----------
    piece_axes : (p,) array of int
        Axes whose hysteresis the pieces change.
    changes : (p,) array
        Of the pieces, in widths of their prior.
    lowest_changes : (p,) array
        Below which the hysteresis would be negative somewhere.
    creep_axes : (q,) array of int
        Axes that creep.
    logarithms : (q,) array
        Of the rates of the creep, in one over the sample period of the model.
    gains : (q,) array
        What the creep comes to, over what moves at once.
    rates : (float, float)
        Least and largest rate. What is slower than recordings last is a line in them, what is as
        fast as the modes is theirs.
    """

    piece_axes: IntArray = field(default_factory=_no_axes)
    changes: FloatArray = field(default_factory=_none)
    lowest_changes: FloatArray = field(default_factory=_none)
    creep_axes: IntArray = field(default_factory=_no_axes)
    logarithms: FloatArray = field(default_factory=_none)
    gains: FloatArray = field(default_factory=_none)
    rates: tuple[float, float] = (0.0, np.inf)

    def vector(self) -> FloatArray:
        """Return the numbers: changes, logarithms of rates, gains."""
        return np.concatenate([self.changes, self.logarithms, self.gains])

    def with_vector(self, vector: FloatArray) -> Self:
        """Return other numbers, in the order of `vector`."""
        changes, logarithms, gains = np.split(vector, np.cumsum([
            self.changes.size, self.logarithms.size]))
        return replace(self, changes=changes, gains=gains,
                       logarithms=np.log(np.clip(np.exp(logarithms), *self.rates)))

    def lowest(self) -> FloatArray:
        """Return the least that each number of `vector` may be; creep goes on as the motion did."""
        return np.concatenate([self.lowest_changes, np.full(self.logarithms.size, -np.inf),
                               np.zeros(self.gains.size)])

    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Return what is expected of the numbers: values over the widths, and one over the widths.

        Both are zero where nothing is.
        """
        expected = np.concatenate([np.ones(self.changes.size), np.zeros(self.logarithms.size),
                                   np.full(self.gains.size, 1.0 / USUAL_CREEP)])
        return expected * self.vector(), expected

    def with_creep(self, axis: int, rate: float, gain: float) -> Self:
        """Return the numbers with further creep of an axis, its rate over the sample rate."""
        return replace(self, creep_axes=np.append(self.creep_axes, axis),
                       logarithms=np.append(self.logarithms, np.log(rate)),
                       gains=np.append(self.gains, gain))

    def kept(self) -> FloatArray:
        """Return the factors by which the creep decays in a sample of the model."""
        return np.exp(-np.exp(self.logarithms))


class Driven:
    """The drive of a spectrum, and what it changes by with each number of the actuators."""

    def __init__(self, numbers: ActuatorNumbers, spectrum: Spectrum, lines: slice) -> None:
        self.numbers, self.held = numbers, spectrum.held
        self.z, passed = spectrum.z[lines][:, None], spectrum.drive[lines]
        self.pieces = np.zeros((len(passed), 0), dtype=complex)
        if numbers.changes.size:
            assert spectrum.pieces is not None
            self.pieces = spectrum.pieces[lines]
            onto = np.eye(passed.shape[1])[numbers.piece_axes]
            passed = passed + self.pieces @ (numbers.changes[:, None] * onto)
        self.passed = passed
        self.kept = numbers.kept() ** self.held
        self.delayed = (1.0 - self.kept) * self.z / (self.z - self.kept)
        onto = np.eye(passed.shape[1])[numbers.creep_axes]
        self.creep = 1.0 + self.delayed @ (numbers.gains[:, None] * onto)
        self.drive = self.creep * passed

    def slopes(self) -> tuple[np.ndarray, ComplexArray]:
        """Return the axis (P,) whose drive each number changes, and by how much, (K, P)."""
        numbers = self.numbers
        passed = self.passed[:, numbers.creep_axes]
        of_rates = numbers.gains * passed * self.z * (self.z - 1.0) / (self.z - self.kept) ** 2 * (
            self.kept * np.exp(numbers.logarithms) * self.held)
        slopes = np.hstack([self.creep[:, numbers.piece_axes] * self.pieces, of_rates,
                            self.delayed * passed])
        return np.concatenate([
            numbers.piece_axes, numbers.creep_axes, numbers.creep_axes]), slopes
