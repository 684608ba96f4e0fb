# SPDX-License-Identifier: BSD-3-Clause
"""Mains hum: a tone with harmonics in a displacement, which the voltage does not explain.

Near the mains frequency, the spectrum of the residual of a model is fitted by what the voltage may
explain: the simulated displacement times a smooth relative error, the rises of the voltage times a
smooth gain, because a hysteresis may answer rises otherwise than falls, the modes of the model with
other residues, and transients, which are smooth in frequency (Pintelon and Schoukens, "System
Identification", 2012, 7.2). A line that stands out of the rest is hum.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.waveforms import played
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_identification.identification.given_data import Data
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.periodic_disturbance import (
    FEWEST_PERIODS,
    HARMONICS,
    WANDERING,
    PeriodicDisturbance,
)
from piezo_recorder.reading.recording import Recording

Lines = NDArray[np.intp]
"""Indices of lines of a spectrum, (n,)."""

MAINS_HZ, DEVIATION = (50.0, 60.0), 0.005
"""Frequencies of mains, and largest relative deviation of mains and the clock of a logger."""

LINES = 40
"""Number of lines of the spectrum on each side of a tone that show what else is there."""

SMOOTH = 3
"""Number of coefficients of what is smooth over these lines."""

ALONE = 10.0
"""Smallest power of a line that stands alone, relative to all other lines near it."""

DRIVEN = 3.0
"""Smallest power of a harmonic of the voltage that counts as standing alone."""

LEVERAGE = 0.5
"""Largest leverage of the lines next to a tone in the regression on the simulated displacement."""

CANDIDATES = 10
"""Number of the largest lines near a mains frequency that may be hum."""


@dataclass(frozen=True, eq=False)
class Hum:
    """Hum in a recording."""

    frequency_hz: float

    signal_um: FloatArray
    """Hum at the rows in which the waveform is played, (N,)."""

    @property
    def amplitude_um(self) -> float:
        """Amplitude of a sine of the same power."""
        return float(np.sqrt(2.0 * np.mean(self.signal_um**2)))

    @property
    def sentence(self) -> str:
        """What is done about the hum, for users."""
        return (f"a hum of {self.amplitude_um:.2g} um at {self.frequency_hz:.2f} Hz, which the "
                "voltage does not explain, was subtracted; it is not part of the model")


def hum_of_each(
    recordings: Mapping[str, Data], model: StageModel, delays_s: Mapping[str, float],
) -> dict[str, Hum]:
    """Return the hum of each recording, with its rows as given, that evidently has one."""
    found = {}
    for name, data in recordings.items():
        # Recordings that are too short to simulate are too short to show a hum.
        with suppress(ValueError):
            if isinstance(data, Recording) and (hum := hum_of(simulated_recording(
                    model, data, read_late_s=-delays_s.get(name, 0.0)))):
                found[name] = hum
    return found


def without_hum(recordings: Mapping[str, Data], humming: Mapping[str, Hum]) -> dict[str, Data]:
    """Return recordings without the hum that `hum_of_each` has found."""
    return {name: _minus(data, humming[name].signal_um)
            if isinstance(data, Recording) and name in humming else data
            for name, data in recordings.items()}


def hum_of(part: SimulatedRecording) -> Hum | None:
    """Return the mains hum in a recording that was simulated by a model; None if there is none.

    The modes of the model may contain the hum.
    """
    spectrum = _Spectrum(part)
    tried = [(line, spectrum.tones(line)) for line in spectrum.candidates()]
    line, tones = max(tried, key=lambda each: sum(tone.evidence for tone in each[1]),
                      default=(0.0, []))
    if not tones:
        return None
    time_s, duration_s = part.time_s - part.time_s[part.begin], spectrum.duration_s
    signal_um = np.zeros(time_s.size)
    for tone in tones:
        disturbance = PeriodicDisturbance(tone.multiple * line / duration_s, 0.0, 0.0)
        signal_um += disturbance.recurrence(time_s, duration_s) @ tone.sizes_um
    return Hum((line + tones[0].turns) / duration_s, signal_um)


@dataclass(frozen=True, eq=False)
class _Tone:
    """A multiple of the frequency of a hum that is evident."""

    multiple: int
    evidence: float
    """Gain in log-evidence."""
    sizes_um: FloatArray
    """Coefficients of `PeriodicDisturbance.recurrence`."""
    turns: float
    """Turns by which its phase moves on in the recording."""


class _Spectrum:
    """Spectra of the residual of a recording, and of what its model explains."""

    def __init__(self, part: SimulatedRecording) -> None:
        simulated_um = part.simulate()
        rises_v = np.maximum(np.diff(part.voltage_v, prepend=part.voltage_v[0]), 0.0)
        self._residual, self._simulated, self._rises, self._drive = (
            np.fft.rfft(signal[part.begin :] - signal[part.begin :].mean()) for signal in (
                part.measured_um - simulated_um, simulated_um, rises_v, part.drive_um))
        self._size = part.time_s.size - part.begin
        self.duration_s = self._size * part.sample_period_s
        voltage_v = part.voltage_v[part.begin :] - part.voltage_v[part.begin :].mean()
        window = np.hanning(self._size)
        self._driven = [np.abs(np.fft.rfft(window * (signal - signal.mean()))) ** 2 for signal in (
            np.sign(voltage_v), np.abs(voltage_v),
            np.sign(voltage_v - 0.5 * voltage_v.std()))]
        # Poles in units of lines.
        self._poles = -0.5j / np.pi * self.duration_s * part.model.linear().poles()
        self._accuracy = self._size * (FIT.model_tolerance * np.ptp(part.measured_um)) ** 2

    def candidates(self) -> list[float]:
        """Return positions in lines at which the fundamental of a hum may lie."""
        found = []
        for hz in MAINS_HZ:
            for multiple in range(1, HARMONICS + 2):
                lines = self._lines_near(multiple * hz)
                largest = lines[np.argsort(-np.abs(self._residual[lines]))[:CANDIDATES]]
                found += [(line + by) / multiple for line in largest for by in (-0.5, 0.0, 0.5)]
        return found

    def tones(self, line: float) -> list[_Tone]:
        """Return the evident tones of a hum."""
        tones = [self._tone(line, multiple) for multiple in range(1, HARMONICS + 2)]
        evident = [tone for tone in tones if tone is not None and tone.evidence > 0.0]
        return evident if tones[0] in evident else []

    def _lines_near(self, hz: float) -> Lines:
        centre, room = hz * self.duration_s, DEVIATION * hz * self.duration_s
        lines = np.arange(int(centre - room), int(np.ceil(centre + room)) + 1)
        return lines[(lines >= FEWEST_PERIODS) & (lines < self._residual.size - FEWEST_PERIODS)]

    def _tone(self, line: float, multiple: int) -> _Tone | None:
        """Fit one tone together with all that the voltage may explain near it."""
        centre = multiple * line
        lines = np.arange(max(int(centre) - LINES, 1),
                          min(int(centre) + LINES + 1, self._residual.size - 1))
        explained = self._explained(lines, centre)
        if lines.size <= 2 * explained.shape[1] or centre > lines[-1] - FEWEST_PERIODS:
            return None
        basis, strengths, _ = np.linalg.svd(
            explained / (np.linalg.norm(explained, axis=0) + np.finfo(float).tiny),
            full_matrices=False)
        basis = basis[:, strengths > 1e-9 * strengths[0]]
        residual, tones = (values - basis @ (basis.conj().T @ values) for values in (
            self._residual[lines, None], self._tone_lines(lines, centre)))
        sizes = np.linalg.lstsq(tones, residual, rcond=1e-9)[0]
        tone, remainder = (np.abs(values) ** 2 for values in (
            tones @ sizes, residual - tones @ sizes))
        if (tone.max() <= ALONE * (remainder.max() + self._accuracy)
                or self._may_be_driven(lines, centre)):
            return None
        before, after = (np.mean(power) + self._accuracy
                         for power in (np.abs(residual) ** 2, remainder))
        evidence = lines.size * np.log(before / after) - WANDERING * np.log(2 * lines.size)
        quarters = np.cos(np.pi * np.outer([0.25, 0.75], np.arange(WANDERING))) @ sizes[:, 0]
        turns = np.angle(quarters[1] * quarters[0].conj()) / np.pi
        return _Tone(multiple, float(evidence),
                     2.0 * np.concatenate([sizes.real, -sizes.imag])[:, 0], float(turns))

    def _may_be_driven(self, lines: Lines, centre: float) -> bool:
        """Return whether a harmonic of the voltage stands nearly alone among some lines."""
        near = np.abs(lines - centre) <= WANDERING
        return any(np.sum(np.abs(np.linalg.qr(columns)[0][near]) ** 2) > LEVERAGE
                   for columns in self._of_gains(lines, centre)) or any(
            power[lines[near]].max() > DRIVEN * power[lines[~near]].max()
            for power in self._driven)

    def _explained(self, lines: Lines, centre: float) -> ComplexArray:
        """Return what the voltage may explain at some lines: the columns of a regression."""
        ringing = 1.0 / (lines[:, None] - self._poles[np.abs(self._poles - centre) < LINES])
        return np.hstack([_powers(lines, centre), *self._of_gains(lines, centre),
                          ringing, ringing * self._drive[lines, None]])

    def _of_gains(self, lines: Lines, centre: float) -> list[ComplexArray]:
        """Return columns of the displacement, and of rises of the voltage, with smooth gains."""
        return [_powers(lines, centre) * spectrum[lines, None]
                for spectrum in (self._simulated, self._rises)]

    def _tone_lines(self, lines: Lines, centre: float) -> ComplexArray:
        """Return the spectrum of a tone, times each of the waves by which it may wander."""
        def at(position: float) -> ComplexArray:
            turns = position - lines
            phase = 2j * np.pi * turns / self._size
            return np.where(turns == 0.0, self._size, np.expm1(self._size * phase)
                            / np.where(turns == 0.0, 1.0, np.expm1(phase)))

        return np.column_stack([0.5 * (at(centre + 0.5 * wave) + at(centre - 0.5 * wave))
                                for wave in range(WANDERING)])


def _powers(lines: Lines, centre: float) -> FloatArray:
    return np.vander((lines - centre) / LINES, SMOOTH)


def _minus(recording: Recording, signal_um: FloatArray) -> Recording:
    """Return a recording without a signal at the rows in which its waveform is played."""
    displacement_um = np.array(recording.displacement_um, dtype=float)
    displacement_um[np.isin(recording.sample_index, played(recording).sample_index)] -= signal_um
    return replace(recording, displacement_um=displacement_um)
