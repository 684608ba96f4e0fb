# SPDX-License-Identifier: BSD-3-Clause
"""Two or three axes that share their modes, with hysteresis and creep in front of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import control
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, eig
from scipy.signal import lfilter

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled_kernels import run_modes
from piezo_models.hysteresis.pasts import PASTS

LEAST_SEPARATION = 1e-10
"""Distance in the z plane below which poles are copies of one; 1000 times the rounding error."""

NEAR = 0.05
"""Largest relative change of a mode's frequency: actuators soften by a few percent."""

SHORTEST_MEMORY = 1e-3
"""Magnitude in the z plane up to which a pole is a rounding error of a delay. A pole of
multiplicity m at 0 has an error of the m-th root of the rounding; no mode decays that fast."""


@dataclass(frozen=True, eq=False)
class Softening:
    """Dependence of the modes and the gain on the amplitude of the voltage.

    Ferroelectric actuators become softer, more lossy and more sensitive with rising amplitude,
    slowly compared with the beats of the modes. Let ``a`` be the deviation of the amplitude from
    the reference, relative to the reference. The elongation of each actuator acts back on its
    voltage: ``v = u - sum over p of a^p (elongation_p of v + gain_p u)``, p from 1 on.
    """

    elongations: ComplexArray
    """Residue of each mode in the elongation of each actuator, by the axis that drives it, (P, K,
    n, n)."""
    gain: FloatArray
    """Part of the voltage itself that acts back, (P, n, n)."""
    reference_v: float
    """RMS of all voltages about the operating point at which the linear part is valid, in V."""
    memory_s: float
    """Time constant in s of the running mean square of the voltage."""
    range_v: tuple[float, float]
    """RMS voltages of the identification in V; beyond them the softening is held constant."""

    def strengths(self, amplitude_v: ArrayLike) -> FloatArray:
        """Return the powers a^p of the relative deviation, shape of the amplitudes and P."""
        away = np.clip(amplitude_v, *self.range_v) / self.reference_v - 1.0
        strengths: FloatArray = away[..., None] ** np.arange(1, len(self.gain) + 1)
        return strengths

    def amplitude_v(self, drive_v: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the running RMS of a voltage, (N, n), about the operating point, shape (N,).

        The mean square starts with its mean over the first `memory_s`.
        """
        square = np.mean(drive_v**2, axis=1)
        begin = square[: max(1, round(self.memory_s / sample_period_s))].mean()
        kept = np.exp(-sample_period_s / self.memory_s)
        mean, _ = lfilter([1.0 - kept], [1.0, -kept], square, zi=[kept * begin])
        amplitude_v: FloatArray = np.sqrt(np.maximum(mean, 0.0))
        return amplitude_v


@dataclass(frozen=True, eq=False)
class CoupledModel:
    """Motion of several axes about an operating point: modes that all of them share.

    The voltage of each axis first passes its actuator, whose output is the drive of the modes.
    """

    axes: tuple[str, ...]
    """Names of the axes, in the order of rows and columns."""
    sample_period_s: float
    """Sample period in s; the voltages are held between the samples."""
    poles_rad_per_s: ComplexArray
    """The upper one of each conjugate pair, (K,); real poles have no imaginary part."""
    residues_um_per_v: ComplexArray
    """Residues of the sampled response by mode, moving axis and driven axis, (K, n, n). The
    response is the sum of ``R / (z - exp(pole T))`` and, for complex poles, their conjugates."""
    direct_um_per_v: FloatArray
    """Motion that follows the voltage of the same sample, of the previous one, and so on, (L, n,
    n)."""
    latency_samples: np.ndarray
    """Delay of each sensor in whole samples, (n,)."""
    operating_voltage_v: FloatArray
    operating_displacement_um: FloatArray
    """Drive and displacement about which the modes move, (n,)."""
    softening: Softening | None = None

    actuators: tuple[Actuator, ...] = ()
    """One for each axis; empty if no axis has hysteresis or creep."""

    def __post_init__(self) -> None:
        modes, n = self.poles_rad_per_s.size, len(self.axes)
        shapes = {
            "residues_um_per_v": (self.residues_um_per_v.shape, (modes, n, n)),
            "direct_um_per_v": (self.direct_um_per_v.shape[1:], (n, n)),
            "latency_samples": (self.latency_samples.shape, (n,)),
            "operating_voltage_v": (self.operating_voltage_v.shape, (n,)),
            "operating_displacement_um": (self.operating_displacement_um.shape, (n,))}
        if self.softening is not None:
            parts = len(self.softening.gain)
            shapes["softening.elongations"] = (
                self.softening.elongations.shape, (parts, modes, n, n))
            shapes["softening.gain"] = (self.softening.gain.shape, (parts, n, n))
        if self.actuators:
            shapes["actuators"] = ((len(self.actuators),), (n,))
        for name, (found, wanted) in shapes.items():
            if found != wanted:
                raise ValueError(f"{name} has the shape {found}; give {wanted}")
        if np.any(self.poles_rad_per_s.real >= 0.0) or np.any(self.poles_rad_per_s.imag < 0.0):
            raise ValueError("a pole is not stable or not of the upper half; give stable ones")

    def __repr__(self) -> str:
        soft = ", softening" if self.softening else ""
        soft += ", hysteresis" if any(each.hysteresis for each in self.actuators) else ""
        soft += ", creep" if any(each.creep.poles_rad_per_s for each in self.actuators) else ""
        return (f"<CoupledModel of {', '.join(self.axes)}: {self.poles_rad_per_s.size} modes at "
                f"{1.0 / self.sample_period_s:.6g} Hz{soft}>")

    @property
    def multiples(self) -> FloatArray:
        """Return how often each pole counts, (m,): a complex one also for its conjugate."""
        return np.where(self.poles_rad_per_s.imag > 0.0, 2.0, 1.0)

    def response(self, frequency_hz: ArrayLike, amplitude_v: float | None = None) -> ComplexArray:
        """Return the response of the modes, from the drive of every axis to every axis.

        Parameters
        ----------
        amplitude_v : float, optional
            RMS voltage in V to which the model softens; the reference by default.

        Returns
        -------
        (F, n, n) array of complex
            Response in um/V, by frequency, moving axis and driven axis.
        """
        z = np.exp(2j * np.pi * np.atleast_1d(frequency_hz) * self.sample_period_s)
        elongations, gain = self._softened(amplitude_v)
        force = np.linalg.solve(np.eye(len(self.axes)) + self._modal(z, elongations),
                                np.eye(len(self.axes)) - gain)
        delays = z[:, None] ** -np.arange(self.direct_um_per_v.shape[0])
        direct = np.einsum("fl,lij->fij", delays, self.direct_um_per_v)
        late = z[:, None] ** -self.latency_samples
        motion = self._modal(z, self.residues_um_per_v) @ force + direct
        response: ComplexArray = late[:, :, None] * motion
        return response

    def _modal(self, z: ComplexArray, residues: ComplexArray) -> ComplexArray:
        steps = np.exp(self.poles_rad_per_s * self.sample_period_s)
        pairs = self.poles_rad_per_s.imag > 0.0
        upper = np.einsum("fk,kij->fij", 1.0 / (z[:, None] - steps), residues)
        lower = np.einsum("fk,kij->fij", 1.0 / (z[:, None] - steps[pairs].conj()),
                          residues[pairs].conj())
        response: ComplexArray = upper + lower
        return response

    def _softened(self, amplitude_v: float | None) -> tuple[ComplexArray, FloatArray]:
        """Return residues and gain of the feedback by softening at an amplitude."""
        if self.softening is None or amplitude_v is None:
            return np.zeros_like(self.residues_um_per_v), np.zeros((len(self.axes),) * 2)
        strengths = self.softening.strengths(amplitude_v)
        return (np.tensordot(strengths, self.softening.elongations, 1),
                np.tensordot(strengths, self.softening.gain, 1))

    def simulate(self, voltage_v: ArrayLike, periodic: bool = False,
                 pasts: Sequence[str] = (), goes_on: bool = False) -> FloatArray:
        """Return the displacement under a voltage.

        Parameters
        ----------
        voltage_v : (N, n) array_like
            Voltages in V, each held for a sample period. The stage has rested at the first one.
        periodic : bool
            True if the voltage has been repeated until the motion is periodic.
        pasts : sequence of str, optional
            How each axis reached its first voltage; see `drive_v`.
        goes_on : bool
            True if the voltage changes linearly between samples instead of being held; the model
            is then one of `at_period` for such voltages.

        Returns
        -------
        (N, n) array
            Displacement in um at the sample instants.

        Raises
        ------
        ValueError
            If the voltage has a wrong shape or is not finite.
        """
        drive_v = self.drive_v(voltage_v, periodic, pasts, goes_on) - self.operating_voltage_v
        motion_um = self._run(drive_v, periodic) + sum(
            _delayed(drive_v, age, periodic) @ tap.T
            for age, tap in enumerate(self.direct_um_per_v))
        late_um = np.column_stack([
            _delayed(column, late, periodic)
            for column, late in zip(motion_um.T, self.latency_samples, strict=True)])
        return late_um + self.operating_displacement_um

    def drive_v(self, voltage_v: ArrayLike, periodic: bool = False,
                pasts: Sequence[str] = (), goes_on: bool = False) -> FloatArray:
        """Return the drive of the modes under a voltage, (N, n), after hysteresis and creep.

        The arguments and errors are those of `simulate`. Each axis reached its first voltage in one
        of `piezo_models.hysteresis.pasts.PASTS`; by default from the lowest one.
        """
        voltages_v = np.asarray(voltage_v, dtype=float)
        if voltages_v.ndim != 2 or voltages_v.shape[1] != len(self.axes) or not voltages_v.size:
            raise ValueError(f"the voltage has the shape {voltages_v.shape}; give (samples, "
                             f"{len(self.axes)}), one column for each of {', '.join(self.axes)}")
        if not np.all(np.isfinite(voltages_v)):
            raise ValueError("a voltage is not finite; mend it or cut it out")
        if not self.actuators:
            return voltages_v
        return np.column_stack([
            actuator.drive_v(column, self.sample_period_s, periodic, past, goes_on)
            for actuator, column, past in zip(
                self.actuators, np.ascontiguousarray(voltages_v.T),
                pasts or PASTS[:1] * len(self.axes), strict=True)])

    def _run(self, drive_v: FloatArray, periodic: bool) -> FloatArray:
        n, multiples = len(self.axes), self.multiples[:, None, None]
        steps = np.exp(self.poles_rad_per_s * self.sample_period_s)
        strengths, gain = np.zeros((len(drive_v), 0)), np.zeros((0, n, n))
        elongations = np.zeros((0, steps.size, n, n), dtype=complex)
        first_v = None
        if self.softening is not None:
            amplitude_v = self.softening.amplitude_v(drive_v, self.sample_period_s)
            strengths, first_v = self.softening.strengths(amplitude_v), amplitude_v[0]
            elongations, gain = self.softening.elongations, self.softening.gain
        back, gain_back = self._softened(first_v)
        at_rest = np.eye(n) + self._modal(np.ones(1, dtype=complex), back)[0].real
        force_v = np.linalg.solve(at_rest, drive_v[0] - gain_back @ drive_v[0])
        state = (force_v / (1.0 - steps[:, None])).astype(complex)
        before, motion_um = state.copy(), np.empty_like(drive_v)
        read = (multiples * self.residues_um_per_v).astype(complex)
        back_read = (multiples * elongations).astype(complex)
        for again in (True, False)[not periodic:]:
            run_modes(drive_v, strengths, steps, read, back_read, gain, state, motion_um)
            if again:  # add up what has not decayed within the period
                left = steps[:, None] ** len(drive_v)
                state = (state - left * before) / (1.0 - left)
        return motion_um

    def at_amplitude(self, amplitude_v: float) -> Self:
        """Return the model without softening that is equivalent at one amplitude."""
        if self.softening is None:
            return self
        return replace(type(self).from_control(
            self.to_control(amplitude_v), self.axes, self.operating_voltage_v,
            self.operating_displacement_um), actuators=self.actuators)

    def at_period(self, sample_period_s: float, goes_on: bool = False) -> Self:
        """Return the model for voltages whose samples are further apart than its own.

        A sensor delay shorter than the new period is included in the response within a sample.

        Parameters
        ----------
        sample_period_s : float
            New sample period in s.
        goes_on : bool
            True if the voltage changes linearly between samples; by default it is held (first-order
            and zero-order hold; Franklin, Powell and Workman 1998, section 6.3).
        """
        held = sample_period_s / self.sample_period_s
        within = self.latency_samples < held
        late = np.where(within, self.latency_samples, 0)[None, :, None]
        steps = np.exp(self.poles_rad_per_s * self.sample_period_s)[:, None, None]
        kept = steps**held

        def reached(samples: FloatArray | float) -> tuple[ComplexArray, ComplexArray]:
            """Return the states after some samples of a step, and of a straight line."""
            step = np.asarray((1.0 - steps**samples) / (1.0 - steps), dtype=complex)
            line = np.asarray(goes_on * (samples - step) / (1.0 - steps) / held, dtype=complex)
            return step, line

        (step, line), (step_seen, line_seen) = reached(held), reached(held - late)
        # What is left from before the last sample of the voltage, by the states at this one.
        lasting = np.abs(kept) > SHORTEST_MEMORY**2
        ago = np.where(lasting, steps ** -np.where(lasting, late, 0), 0.0)
        states = step - (1.0 - kept) * line

        def directly(*parts: ComplexArray) -> FloatArray:
            return np.array([np.einsum("k,kij->ij", self.multiples, (
                part * self.residues_um_per_v).real) for part in parts])

        taps = directly(line_seen, step_seen - line_seen - ago * (step - line))
        for age, tap in enumerate(self.direct_um_per_v):
            before = np.minimum((late[0] + age) / held, 1.0) if goes_on else late[0] + age > 0
            taps += np.array([(1.0 - before) * tap, before * tap])
        softening = self.softening and replace(
            self.softening, elongations=states * self.softening.elongations,
            gain=self.softening.gain + np.einsum(
                "k,pkij->pij", self.multiples, (line * self.softening.elongations).real))
        return replace(
            self, sample_period_s=sample_period_s,
            residues_um_per_v=ago * states * self.residues_um_per_v, direct_um_per_v=taps,
            softening=softening, latency_samples=np.where(
                within, 0, np.round(self.latency_samples / held)).astype(int))

    def mode_near(self, frequency_hz: float, amplitude_v: float | None = None) -> complex:
        """Return the pole in rad/s of the highest resonance near a frequency.

        It is within the fraction `NEAR` of the frequency. The model softens to the amplitude, an
        RMS voltage in V, by default the reference. Raises ValueError if there is no such mode.
        """
        linear = self if amplitude_v is None else self.at_amplitude(amplitude_v)
        poles = linear.poles_rad_per_s
        height = np.linalg.norm(linear.residues_um_per_v, axis=(1, 2)) / -poles.real
        off = np.abs(np.abs(poles) / (2.0 * np.pi * frequency_hz) - 1.0)
        near = (poles.imag > 0.0) & (off < NEAR)
        if not near.any():
            raise ValueError(f"there is no mode within {100 * NEAR:.0f} % of {frequency_hz:.4g} Hz")
        return complex(poles[np.argmax(np.where(near, height, 0.0))])

    def to_control(self, amplitude_v: float | None = None) -> control.StateSpace:
        """Return the modes at an amplitude as a discrete system of python-control.

        Parameters
        ----------
        amplitude_v : float, optional
            RMS voltage in V to which the model softens; the reference by default.

        Returns
        -------
        control.StateSpace
            System from ``x_voltage_v``, ... to ``x_displacement_um``, ..., about the operating
            point.
        """
        n = len(self.axes)
        modes, drive = _copies_of_modes(
            np.exp(self.poles_rad_per_s * self.sample_period_s), n)
        elongations, gain = self._softened(amplitude_v)
        modes = modes - drive @ self._readout(elongations)
        read = self._readout(self.residues_um_per_v)
        modal = control.ss(modes, drive @ (np.eye(n) - gain), read, np.zeros((n, n)),
                           self.sample_period_s)
        late = np.zeros((self.latency_samples.max() + 1, n, n))
        late[self.latency_samples, range(n), range(n)] = 1.0
        system = _shift_register(late, self.sample_period_s) * (
            modal + _shift_register(self.direct_um_per_v, self.sample_period_s))
        return control.ss(system, inputs=[f"{axis}_voltage_v" for axis in self.axes],
                          outputs=[f"{axis}_displacement_um" for axis in self.axes])

    def _readout(self, residues: ComplexArray) -> FloatArray:
        """Return the output matrix for the states of `_copies_of_modes`, shape (n, states)."""
        columns = []
        for residue, pole in zip(residues, self.poles_rad_per_s, strict=True):
            columns += [2.0 * residue.real, -2.0 * residue.imag] if pole.imag else [residue.real]
        return np.hstack(columns)

    @classmethod
    def from_control(
        cls, system: control.StateSpace | control.TransferFunction, axes: tuple[str, ...],
        operating_voltage_v: ArrayLike | None = None,
        operating_displacement_um: ArrayLike | None = None,
    ) -> Self:
        """Return the modal model of a discrete system of python-control.

        Parameters
        ----------
        system : control.StateSpace or control.TransferFunction
            Discrete and stable, with as many inputs as outputs and distinct poles.
        operating_voltage_v, operating_displacement_um : (n,) array_like, optional
            Operating point in V and um; 0 by default.

        Raises
        ------
        ValueError
            If the system does not satisfy these conditions.
        """
        n = len(axes)
        if (system.ninputs, system.noutputs) != (n, n):
            raise ValueError(f"the system has {system.ninputs} inputs and {system.noutputs} "
                             f"outputs; give {n} of each, one for each axis")
        if not system.dt or system.dt is True:
            raise ValueError("the system has no sample period; give a discrete one, such as by "
                             "control.sample_system(system, sample_period_s)")
        a, b, c, d = map(np.asarray, control.ssdata(control.ss(system)))
        found, left, right = eig(a, left=True, right=True)
        if np.any(np.abs(found) >= 1.0):
            raise ValueError("the system is not stable; give a stable one")
        lasting = np.abs(found) > SHORTEST_MEMORY
        steps, residues = _poles_and_residues(
            found[lasting], c @ right[:, lasting], left[:, lasting].conj().T @ b,
            left[:, lasting].conj().T @ right[:, lasting])
        taps, power = [d], b
        for age in range(np.count_nonzero(~lasting)):
            modal = np.einsum("k,kij->ij", steps**age, residues).real
            taps.append(c @ power - modal)
            power = a @ power
        upper, period_s = steps.imag >= 0.0, float(system.dt)
        zeros = np.zeros(n)
        poles = (np.log(steps[upper]) / period_s).astype(complex)
        return cls(
            axes, period_s, poles, residues[upper], np.array(taps),
            np.zeros(n, dtype=int),
            zeros if operating_voltage_v is None else np.asarray(operating_voltage_v, float),
            zeros if operating_displacement_um is None
            else np.asarray(operating_displacement_um, float))


def _poles_and_residues(
    found: ComplexArray, read: ComplexArray, drive: ComplexArray, overlap: ComplexArray,
) -> tuple[ComplexArray, ComplexArray]:
    """Return each pole once, with the sum of the residues of its copies.

    The eigenvalues of the system matrix, (k,), come with its right eigenvectors times the output
    matrix, (n, k), its left eigenvectors times the input matrix, (k, n), and the products of left
    and right eigenvectors, (k, k).
    """
    steps, residues, remaining = [], [], np.arange(found.size)
    while remaining.size:
        near = np.abs(found[remaining] - found[remaining[0]]) < LEAST_SEPARATION
        copies, remaining = remaining[near], remaining[~near]
        of_copies = overlap[np.ix_(copies, copies)]
        if np.linalg.norm(of_copies, -2) < LEAST_SEPARATION:  # the smallest singular value
            raise ValueError("two modes of the system are one that grows with time before it "
                             "decays; give a system whose modes differ")
        steps.append(found[copies].mean())
        residues.append(read[:, copies] @ np.linalg.solve(of_copies, drive[copies]))
    axes = read.shape[0]
    return np.array(steps), np.array(residues, dtype=complex).reshape(-1, axes, axes)


def _delayed(signal: FloatArray, samples: int, periodic: bool) -> FloatArray:
    """Return a signal delayed by samples; before it is its period or its first value."""
    if not samples:
        return signal
    if periodic:
        return np.roll(signal, samples, axis=0)
    delayed = np.empty_like(signal)
    delayed[:samples] = signal[0]
    delayed[samples:] = signal[: max(len(signal) - samples, 0)]
    return delayed


def _copies_of_modes(steps: ComplexArray, axes: int) -> tuple[FloatArray, FloatArray]:
    """Return the real system and input matrices of the modes, with a copy for each axis."""
    blocks, drives = [], []
    for step in steps:
        if step.imag:
            blocks.append(np.array([[step.real, -step.imag], [step.imag, step.real]]))
            drives += [1.0, 0.0]
        else:
            blocks.append(np.array([[step.real]]))
            drives.append(1.0)
    # States in the order mode, part, axis, like the columns of `_readout`.
    return np.kron(block_diag(*blocks), np.eye(axes)), np.kron(
        np.array(drives)[:, None], np.eye(axes))


def _shift_register(taps: FloatArray, sample_period_s: float) -> control.StateSpace:
    """Return the FIR system with these taps, shape (L, n, n)."""
    past, n = len(taps) - 1, taps.shape[1]
    shift = np.kron(np.eye(past, k=-1), np.eye(n))
    enter = np.kron(np.eye(past, 1), np.eye(n))
    read = np.hstack([*taps[1:], np.zeros((n, 0))])
    return control.ss(shift, enter, read, taps[0], sample_period_s)
