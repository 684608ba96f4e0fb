# SPDX-License-Identifier: BSD-3-Clause
"""A model of several axes together with the results of its identification."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_models.axes.coupled import CoupledModel

NORMAL_90 = 1.6449
"""Standard deviations within which 90 % of a normal distribution lie."""


LIGHT = 0.05
"""Damping ratio up to which a pair of poles is a visible resonance."""


@dataclass(frozen=True, eq=False)
class Coupling:
    """The response from every axis to every axis at some frequencies, with standard deviations."""

    frequency_hz: FloatArray
    """Shape (F,)."""
    gain_um_per_v: ComplexArray
    """Response by frequency, moving axis and driven axis, (F, n, n); at the reference amplitude."""
    deviation_um_per_v: ComplexArray
    """Standard deviations of the real parts (real) and the imaginary parts (imaginary), (F, n,
    n)."""

    def interval_90(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the lower and upper ends of the 90 % intervals of real and imaginary parts."""
        half = NORMAL_90 * self.deviation_um_per_v
        return self.gain_um_per_v - half, self.gain_um_per_v + half


@dataclass(frozen=True, eq=False)
class IdentifiedAxes:
    """A model of several axes with the results of its identification."""

    model: CoupledModel

    voltage_range_v: FloatArray
    """Lowest and highest voltage of each axis in V, (n, 2)."""
    coupling: Coupling

    pole_deviations_rad_per_s: ComplexArray
    """Standard deviations of the real parts (real) and the imaginary parts (imaginary), (K,)."""
    residue_deviations_um_per_v: ComplexArray
    """The same for the residues, (K, n, n)."""
    delays_s: FloatArray
    delay_deviations_s: FloatArray
    """Delay of each sensor from the phases of the modes, (n,); `CoupledModel` uses whole
    samples."""
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    """``e_y_percent`` of each axis on data that was not fitted."""
    recordings: Sequence[dict[str, str]] = ()
    """Recordings that the model was identified from."""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """Time of creation, ISO 8601."""
    unfinished: str = ""
    """Why the identification ended early; empty if it was completed."""

    def __repr__(self) -> str:
        return f"<IdentifiedAxes of {self.created}: {self.model!r}>"

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def response_deviation_um_per_v(self, frequency_hz: ArrayLike) -> FloatArray:
        """Return the standard deviation of each entry of the complex response, (F, n, n), in um/V.

        The deviations of poles and residues give the shape over frequency, including resonances.
        They are scaled to those of the coupling, which include the correlations.
        """
        wanted_hz, known_hz = np.asarray(frequency_hz, float), self.coupling.frequency_hz
        course = self._deviation_of_modes(known_hz)
        known = np.abs(self.coupling.deviation_um_per_v)
        share = np.divide(known, course, out=np.ones_like(known), where=course > 0.0)
        at = np.log(np.maximum(wanted_hz, known_hz[0]))
        deviation = self._deviation_of_modes(wanted_hz)
        for i, j in np.ndindex(*deviation.shape[1:]):
            deviation[:, i, j] *= np.interp(at, np.log(known_hz), share[:, i, j])
        return deviation

    def _deviation_of_modes(self, frequency_hz: FloatArray) -> FloatArray:
        """Return deviations that follow from those of poles and residues if uncorrelated."""
        model, period_s = self.model, self.model.sample_period_s
        z = np.exp(2j * np.pi * frequency_hz * period_s)[:, None, None]
        square = np.zeros((frequency_hz.size, len(model.axes), len(model.axes)))
        for pole, residue, pole_off, off in zip(
                model.poles_rad_per_s, model.residues_um_per_v, self.pole_deviations_rad_per_s,
                self.residue_deviations_um_per_v, strict=True):
            step = np.exp(pole * period_s)
            upper, lower = 1.0 / (z - step), (pole.imag > 0.0) / (z - step.conj())
            moved = period_s * step * upper**2 * residue
            mirrored = period_s * step.conj() * lower**2 * residue.conj()
            square += (np.abs((upper + lower) * off.real) ** 2
                       + np.abs((upper - lower) * off.imag) ** 2
                       + np.abs((moved + mirrored) * pole_off.real) ** 2
                       + np.abs((moved - mirrored) * pole_off.imag) ** 2)
        deviation: FloatArray = np.sqrt(square)
        return deviation

    def summary(self) -> SummaryTable:
        """Return modes with deviations, static coupling, delays and softening as a table."""
        model = self.model
        rows: list[tuple[str | float | None, ...]] = []
        for number, (pole, off) in enumerate(zip(
                model.poles_rad_per_s, self.pole_deviations_rad_per_s, strict=True), start=1):
            if pole.imag:
                rows.append((f"mode {number} frequency", "Hz", abs(pole) / (2.0 * np.pi),
                             off.imag / (2.0 * np.pi)))
                rows.append((f"mode {number} damping ratio", "1", -pole.real / abs(pole),
                             off.real / abs(pole)))
            else:
                rows.append((f"mode {number} rate", "rad/s", -pole.real, off.real))
        lowest = int(np.argmin(self.coupling.frequency_hz))
        at_hz = self.coupling.frequency_hz[lowest]
        for i, moved in enumerate(model.axes):
            for j, driven in enumerate(model.axes):
                rows.append((f"{moved} from {driven} at {at_hz:.3g} Hz", "um/V",
                             self.coupling.gain_um_per_v[lowest, i, j].real,
                             self.coupling.deviation_um_per_v[lowest, i, j].real))
        rows += [(f"delay of {axis}", "s", float(delay_s), float(off_s)) for axis, delay_s, off_s in
                 zip(model.axes, self.delays_s, self.delay_deviations_s, strict=True)]
        for axis, each in zip(model.axes, model.actuators, strict=False):
            if each.lag_s:
                rows.append((f"amplifier lag of {axis}", "s", each.lag_s, None))
            if each.bouc_wen is not None:
                units = each.bouc_wen.units()
                rows += [(f"{name} of {axis}, {each.bouc_wen.name}", units[name], value, None)
                         for name, value in each.bouc_wen.parameters().items()]
        notes = [f"{axis}: e_y {error['e_y_percent']:.3g} % on data that was not fitted"
                 for axis, error in self.errors.items()]
        notes += self.softening_sentences()
        if self.unfinished:
            notes.append(f"unfinished: {self.unfinished}")
        return SummaryTable(repr(model)[1:-1], ("parameter", "unit", "value", "std. dev."), rows,
                            tuple(notes))

    def softening_sentences(self) -> list[str]:
        """Return sentences on how the static gain and the highest modes change with amplitude.

        A mode is excluded if a higher one is near, or if its damping is uncertain by half or more.
        """
        softening = self.model.softening
        if softening is None:
            return []
        low, high = softening.range_v
        gain, more = (np.trace(self.model.response(0.0, each)[0].real) for each in (low, high))
        sentences = [
            f"softening: as the RMS of the voltages rises from {low:.3g} to {high:.3g} V, the "
            f"static gain changes by {100 * (more / gain - 1):+.2g} % (amplitude-dependent gain), "
            "and"]
        poles = self.model.poles_rad_per_s
        known = self.pole_deviations_rad_per_s.real < -0.5 * poles.real
        seen = (poles.imag > 0.0) & (poles.real > -LIGHT * np.abs(poles)) & known
        for pole in sorted(poles[seen], key=abs):
            frequency_hz = abs(pole) / (2.0 * np.pi)
            if self.model.mode_near(frequency_hz) != pole:
                continue  # a higher one is near
            stiff, soft = (self.model.mode_near(frequency_hz, each) for each in (low, high))
            sentences.append(
                f"  the mode at {frequency_hz:.4g} Hz by {100 * (abs(soft) / abs(stiff) - 1):+.2g} "
                f"% (amplitude-dependent stiffness), its damping ratio from "
                f"{-stiff.real / abs(stiff):.3g} to {-soft.real / abs(soft):.3g} "
                "(amplitude-dependent damping)")
        return sentences
