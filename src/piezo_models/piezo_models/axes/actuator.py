# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep of the actuator of one axis, in front of the modes that all axes share."""

from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.pasts import PASTS, past_voltages
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics


@dataclass(frozen=True, eq=False)
class Actuator:
    """Convert the voltage of an axis to its drive, a voltage without hysteresis and creep."""

    hysteresis: PreisachModel | None = None
    """Its output over its mean slope is the voltage that it passes on. Over its whole range this
    changes by as much as the voltage; beyond the range it follows the voltage."""
    creep: CreepDynamics = CreepDynamics()
    """Creep of the drive, behind the hysteresis."""
    lag_s: float = 0.0
    """Time constant of the amplifier, which the hysteresis follows. The drive is the voltage that
    would move a stage without hysteresis and creep alike: the modes contain this lag as a pole."""
    bouc_wen: BoucWenHysteresis | None = None
    """Hysteresis whose loops drift, in front of `hysteresis`, which gives its range."""

    def __post_init__(self) -> None:
        if self.bouc_wen is not None and self.hysteresis is None:
            raise ValueError("bouc_wen has no range without hysteresis; give one, such as a line")

    @property
    def slope_um_per_v(self) -> float:
        """Return the mean slope of the hysteresis over its range."""
        return 1.0 if self.hysteresis is None else self.hysteresis.mean_gain_um_per_v

    def passed_v(self, voltage_v: FloatArray, periodic: bool = False,
                 past: str = PASTS[0]) -> FloatArray:
        """Return the voltage that the hysteresis passes on, (N,).

        The voltage has been repeated before if it is periodic; else `past`, one of `PASTS`, says
        how the first one was reached.
        """
        hysteresis = self.hysteresis
        if hysteresis is None:
            return voltage_v
        low_v, high_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
        past_v = past_voltages(past, voltage_v[0], low_v, high_v)
        voltage_v = self._drifting_v(voltage_v, np.concatenate([[low_v, high_v], past_v]), periodic)
        memory = hysteresis.memory()
        hysteresis.simulate(past_v, memory)
        if periodic:
            hysteresis.simulate(voltage_v, memory)
        risen_um = hysteresis.simulate(voltage_v, memory) - hysteresis.offset_um
        return (hysteresis.voltage_min_v + risen_um / self.slope_um_per_v
                + voltage_v - self._within(voltage_v))

    def drive_v(self, voltage_v: FloatArray, sample_period_s: float, periodic: bool = False,
                past: str = PASTS[0], goes_on: bool = False) -> FloatArray:
        """Return the drive of the modes under a voltage; creep has settled at its beginning.

        If it goes on, the voltage changes linearly between samples; else it is held, and the drive
        is that at the end of the sample. The other arguments are those of `passed_v`.
        """
        lag = _kept(self.lag_s, sample_period_s)
        passed_v = self.passed_v(_followed_v(voltage_v, lag, 0.0, periodic), periodic, past)
        before_v = np.append(passed_v[-1 if periodic else 0], passed_v[:-1])
        passed_v = (passed_v - lag * before_v) / (1.0 - lag)
        drive_v = passed_v.copy()
        for gain, rate in zip(self.creep_gains, self.creep.poles_rad_per_s, strict=True):
            kept = np.exp(-rate * sample_period_s)
            behind = (1.0 - kept) / (rate * sample_period_s) - kept if goes_on else 0.0
            drive_v += gain * _followed_v(passed_v, kept, behind, periodic)
        return drive_v

    @property
    def creep_gains(self) -> FloatArray:
        """Return the final creep behind each pole, relative to the immediate motion."""
        poles, zeros = (np.array(values, dtype=float) for values in (
            self.creep.poles_rad_per_s, self.creep.zeros_rad_per_s))
        apart = poles[None, :] - poles[:, None] + np.diag(poles)
        gains: FloatArray = np.prod(zeros[None, :] - poles[:, None], axis=1) / np.prod(
            apart, axis=1)
        return gains

    def creep_response(self, frequency_hz: ArrayLike, sample_period_s: float) -> ComplexArray:
        """Return the response of the creep from sample to sample.

        A held drive has crept by the end of the sample, because the modes are fast compared with
        the creep at any sample period.
        """
        z = np.exp(2j * np.pi * np.asarray(frequency_hz) * sample_period_s)
        response = np.ones_like(z)
        for gain, rate in zip(self.creep_gains, self.creep.poles_rad_per_s, strict=True):
            kept = np.exp(-rate * sample_period_s)
            response += gain * (1.0 - kept) * z / (z - kept)
        return response

    def creep_system(self, sample_period_s: float) -> control.StateSpace:
        """Return the creep from sample to sample as a discrete system, see `creep_response`."""
        kept = np.exp(-np.array(self.creep.poles_rad_per_s) * sample_period_s)
        gains = self.creep_gains * (1.0 - kept)
        return control.ss(np.diag(kept), np.ones((kept.size, 1)), (gains * kept)[None, :],
                          [[1.0 + gains.sum()]], sample_period_s)

    def inverse_v(self, drive_v: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the periodic voltage that produces a periodic drive (V), (N,).

        Raises ValueError if the hysteresis has no inverse.
        """
        lines = np.fft.rfft(drive_v)
        lines /= self.creep_response(
            np.fft.rfftfreq(drive_v.size, sample_period_s), sample_period_s)
        lag = _kept(self.lag_s, sample_period_s)
        passed_v = _followed_v(np.fft.irfft(lines, drive_v.size), lag, 0.0, periodic=True)
        hysteresis = self.hysteresis
        if hysteresis is None:
            return np.asarray(np.fft.irfft(lines, drive_v.size))
        within_v = self._within(passed_v)
        wanted_um = hysteresis.offset_um + self.slope_um_per_v * (
            within_v - hysteresis.voltage_min_v)
        memory = hysteresis.memory()
        hysteresis.invert(wanted_um, memory)  # first pass: the past is the period itself
        followed_v = hysteresis.invert(wanted_um, memory) + passed_v - within_v
        if self.bouc_wen is not None:
            followed_v = self.bouc_wen.compensate(followed_v, sample_period_s)
        return (followed_v - lag * np.roll(followed_v, 1)) / (1.0 - lag)

    def _drifting_v(self, voltage_v: FloatArray, past_v: FloatArray,
                    periodic: bool) -> FloatArray:
        """Return the voltage behind the Bouc-Wen hysteresis, (N,).

        The past is what preceded the first voltage, or the first period.
        """
        if self.bouc_wen is None:
            return voltage_v
        memory = self.bouc_wen.memory_after(past_v)
        if periodic:
            _, memory = self.bouc_wen.advance(voltage_v, 1.0, memory)
        return self.bouc_wen.advance(voltage_v, 1.0, memory)[0]

    def _within(self, voltage_v: FloatArray) -> FloatArray:
        assert self.hysteresis is not None
        return np.clip(voltage_v, self.hysteresis.voltage_min_v, self.hysteresis.voltage_max_v)


def _kept(time_constant_s: float, sample_period_s: float) -> float:
    """Return the part of a voltage that is kept over a sample by a lag."""
    return float(np.exp(-sample_period_s / time_constant_s)) if time_constant_s > 0.0 else 0.0


def _followed_v(voltage_v: FloatArray, kept: float, behind: float,
                periodic: bool) -> FloatArray:
    """Return a voltage, (N,), behind a lag of first order, at the ends of the samples.

    The lag keeps a part of its output over a sample. The weight of the sample before is 0 for a
    voltage that is held. If the voltage was not repeated before, the lag has settled at its
    beginning.
    """
    follows, last_v = [1.0 - kept - behind, behind], voltage_v[-1 if periodic else 0]
    settled_v = last_v
    if periodic:
        decayed_v, _ = lfilter(follows, [1.0, -kept], voltage_v, zi=[behind * last_v])
        settled_v = decayed_v[-1] / (1.0 - kept ** voltage_v.size)
    followed_v: FloatArray = lfilter(follows, [1.0, -kept], voltage_v,
                                     zi=[kept * settled_v + behind * last_v])[0]
    return followed_v
