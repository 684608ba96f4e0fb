# SPDX-License-Identifier: BSD-3-Clause
"""A measured voltage that is smooth between its rows."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import Effect, Evidence

BEYOND = 256
"""Rows by which the voltage is extended at either end of a recording by point reflection; their
effect on the rows inside decreases with the inverse of the distance."""


@dataclass(frozen=True)
class BandLimitedVoltage(Effect):
    """The voltage of a row is a sample of a smooth voltage, not held until the next row.

    This holds for a voltage that passed a filter and was measured like the displacement: it has no
    content above half the row rate, so that its samples determine it (Pintelon and Schoukens,
    "System Identification", 2012, 13.2). It is a property of recordings. Voltages that are sent are
    held, and `StageModel.simulate` assumes this.
    """

    name: ClassVar[str] = "band_limited_voltage"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics up to a third of the sample rate"
    distortion: ClassVar[frozenset[str] | None] = frozenset()

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal unchanged; only the voltage between the rows differs."""
        return signal

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: None = None) -> tuple[FloatArray, None]:
        """Return the signal unchanged; there is no past."""
        return signal, None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Return none: `identify` compares it with a held voltage, all other parameters free."""
        return []


def means_of_parts(voltage_v: FloatArray, parts: int) -> FloatArray:
    """Return the means of a band-limited voltage over the parts of its rows, (N parts,).

    The voltage is that at the beginning of each row in V, (N,).
    """
    rows = voltage_v.size
    beyond = min(BEYOND, rows - 1)
    if beyond < 1:
        return np.repeat(voltage_v, parts)
    first, last = voltage_v[0], voltage_v[-1]
    extended = np.concatenate([
        2.0 * first - voltage_v[beyond:0:-1], voltage_v,
        2.0 * last - voltage_v[-2 : -beyond - 2 : -1]])
    size = next_fast_len(extended.size, real=True)
    # A straight line closes the period.
    closing = np.linspace(extended[-1], extended[0], size - extended.size + 2)[1:-1]
    cycles = rfftfreq(size) / parts
    lines = rfft(np.concatenate([extended, closing])) * np.exp(1j * np.pi * cycles)
    fine = np.zeros(size * parts // 2 + 1, dtype=complex)
    fine[: lines.size] = parts * np.sinc(cycles) * lines
    if size % 2 == 0:
        fine[lines.size - 1] *= 0.5
    begin = beyond * parts
    return irfft(fine, size * parts)[begin : begin + rows * parts]
