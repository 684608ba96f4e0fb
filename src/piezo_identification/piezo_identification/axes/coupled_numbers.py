# SPDX-License-Identifier: BSD-3-Clause
"""The numbers of a coupled model as a fit takes them, and how motions depend on them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.axes.shared_poles import (
    LEAST_STEP,
    delays,
    slopes_of_basis,
)
from piezo_identification.axes.spectra import Spectrum
from piezo_identification.estimators.poles.vector_fitting import mode_basis, real_form

SLOWEST = 1e-5
"""Least decay of a mode in a sample, and least turn of a pair: it would ring for 100 000 samples,
longer than recordings last."""


@dataclass(frozen=True, eq=False)
class CoupledNumbers:
    """Numbers of a coupled model, for n axes and m columns of `mode_basis`."""

    steps: ComplexArray
    """Poles in the z plane, as `shared_poles.relocated` gives them."""
    gains: FloatArray
    """Gains of the columns, by moving axis and driven axis, (m, n, n)."""
    direct: FloatArray
    """Shape (L, n, n)."""
    back: FloatArray
    """Gains of the columns in the elongations of the softening, by power of the amplitude,
    (P, m, n, n); P is 0 without softening."""
    back_gain: FloatArray
    """Shape (P, n, n)."""
    reference_v: float
    """Amplitude at which nothing softens."""
    softening: FloatArray
    """1 for the columns that may act back, 0 for the others, (m,)."""
    slowest: float = 0.0
    """Least size of a pole's logarithm: what is slower is creep."""

    @property
    def logarithms(self) -> FloatArray:
        """Return the numbers of the poles: see `shared_poles.slopes_of_basis`."""
        of = np.log(self.steps)
        pairs = self.steps.imag > 0.0
        return np.concatenate([np.column_stack([of[pairs].real, of[pairs].imag]).ravel(),
                               of[~pairs].real])

    def shared(self) -> FloatArray:
        """Return the numbers on which all motions depend."""
        return np.concatenate([self.logarithms, self.back.ravel(), self.back_gain.ravel()])

    def own(self) -> FloatArray:
        """Return the numbers of each motion, (n, count)."""
        moved = np.concatenate([self.gains, self.direct]).transpose(1, 0, 2)
        return moved.reshape(moved.shape[0], -1)

    def with_numbers(self, shared: FloatArray, own: FloatArray) -> Self:
        """Return the model with other numbers, in the order of `shared` and `own`.

        Poles stay stable, and those of pairs in the upper half plane.
        """
        m, n, _ = self.gains.shape
        pairs = int(np.count_nonzero(self.steps.imag > 0.0))
        of_pairs = shared[: 2 * pairs].reshape(pairs, 2)
        decays = np.clip(np.concatenate([of_pairs[:, 0], shared[2 * pairs:m]]),
                         np.log(LEAST_STEP), -SLOWEST)
        turns = np.zeros(decays.size)
        turns[:pairs] = np.clip(of_pairs[:, 1], SLOWEST, np.pi - SLOWEST)
        logarithms = decays + 1j * turns
        logarithms = logarithms * np.maximum(1.0, self.slowest / np.abs(logarithms))
        steps = np.exp(logarithms)
        moved = own.reshape(n, -1, n).transpose(1, 0, 2)
        back, gain = np.split(shared[m:], [self.back.size])
        return replace(self, steps=steps, gains=moved[:m], direct=moved[m:],
                       back=back.reshape(self.back.shape),
                       back_gain=gain.reshape(self.back_gain.shape))

    def with_poles(self, kept: BoolArray) -> Self:
        """Return the model with some of its poles alone, (poles,)."""
        pairs = self.steps.imag > 0.0
        columns = np.concatenate([np.repeat(kept[pairs], 2), kept[~pairs]])
        return replace(self, steps=self.steps[kept], gains=self.gains[columns],
                       back=self.back[:, columns], softening=self.softening[columns])

    def strengths(self, amplitude_v: float) -> FloatArray:
        """Return powers of the amplitude's distance from the reference, in parts of it."""
        away = amplitude_v / self.reference_v - 1.0
        return np.array([away**power for power in range(1, len(self.back) + 1)])

    def is_stable(self, amplitude_v: float) -> bool:
        """Return whether the motion is stable with the feedback of the softening."""
        m, n, _ = self.gains.shape
        back = np.tensordot(self.strengths(amplitude_v), self.back, 1)
        dynamics, drive = real_form(self.steps)
        closed = np.kron(dynamics, np.eye(n)) - np.kron(drive[:, None], np.eye(n)) @ (
            back.transpose(1, 0, 2).reshape(n, m * n))
        return bool(np.abs(np.linalg.eigvals(closed)).max(initial=0.0) < 1.0)

    def motions(self, spectra: Sequence[Spectrum]) -> list[ComplexArray]:
        """Return the motion of each spectrum, (K, n), without transients."""
        return [Linearised(self, spectrum).motion for spectrum in spectra]


class Linearised:
    """The motion of a spectrum, and what it changes by with each number."""

    def __init__(self, numbers: CoupledNumbers, spectrum: Spectrum, lines: slice = slice(None),
                 ) -> None:
        self.numbers, n = numbers, spectrum.drive.shape[1]
        self.z, self.drive = spectrum.z[lines], spectrum.drive[lines]
        self.basis = mode_basis(self.z, numbers.steps)
        self.strengths = numbers.strengths(spectrum.amplitude_v)
        self.taps = delays(self.z, len(numbers.direct))
        self.modal = np.tensordot(self.basis, numbers.gains, 1)
        self.gains_back = np.tensordot(self.strengths, numbers.back, 1)
        back = np.tensordot(self.basis, self.gains_back, 1)
        self.closing = np.linalg.inv(np.eye(n) + back)
        pushing = np.eye(n) - np.tensordot(self.strengths, numbers.back_gain, 1)
        self.force = np.einsum("kij,kj->ki", self.closing, self.drive @ pushing.T)
        direct = np.tensordot(self.taps, numbers.direct, 1)
        self.response = self.modal @ self.closing @ pushing + direct
        self.motion = np.einsum("kij,kj->ki", self.response, self.drive)

    def pulls(self, pull: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Return the products of the slopes with a motion, (K, n), summed over the lines.

        They are those of the numbers of each motion, (n, count), and of the shared ones, (count,).
        """
        own = np.real(pull.conj().T @ self.own_slopes())
        through = -np.einsum("ki,kij->kj", pull.conj(), self.modal @ self.closing)
        of_modes = np.einsum("ki,mij,kj->km", pull.conj(), self.numbers.gains, self.force,
                             optimize=True)
        of_modes += np.einsum("kq,mqj,kj->km", through, self.gains_back, self.force, optimize=True)
        of_poles = np.einsum(
            "pkm,km->p", slopes_of_basis(self.z, self.numbers.steps), of_modes,
            optimize=True)
        of_back = np.einsum("s,kq,m,km,kj->smqj", self.strengths, through,
                            self.numbers.softening, self.basis, self.force, optimize=True)
        of_gain = np.einsum("s,kq,kj->sqj", self.strengths, through, self.drive, optimize=True)
        return own, np.real(np.concatenate([of_poles, of_back.ravel(), of_gain.ravel()]))

    def own_slopes(self) -> ComplexArray:
        """Return the slopes of a motion over its own numbers, (K, count): alike for all."""
        columns = [self.basis[:, :, None] * self.force[:, None, :],
                   self.taps[:, :, None] * self.drive[:, None, :]]
        return np.concatenate(columns, axis=1).reshape(self.z.size, -1)

    def shared_slopes(self) -> ComplexArray:
        """Return the slopes of all motions over the shared numbers, (n, K, count)."""
        slopes = slopes_of_basis(self.z, self.numbers.steps)
        through = -self.modal @ self.closing
        changed = np.einsum("pkm,mij,kj->ikp", slopes, self.numbers.gains, self.force,
                            optimize=True)
        changed += np.einsum("kiq,pkm,mqj,kj->ikp", through, slopes, self.gains_back, self.force,
                             optimize=True)
        n, lines = changed.shape[:2]
        of_modes = np.einsum("s,kiq,m,km,kj->iksmqj", self.strengths, through,
                             self.numbers.softening, self.basis, self.force, optimize=True)
        of_gain = np.einsum("s,kiq,kj->iksqj", self.strengths, through, self.drive, optimize=True)
        return np.concatenate([changed, of_modes.reshape(n, lines, -1),
                               of_gain.reshape(n, lines, -1)], axis=2)
