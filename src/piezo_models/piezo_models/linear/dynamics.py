# SPDX-License-Identifier: BSD-3-Clause
"""Linear dynamics behind the hysteresis: creep, electric and vibration dynamics, and sampling.

The state space is a cascade of sections of first and second order, whose states have the magnitude
of their input. Creep poles of hundredths of rad/s and modes of thousands of rad/s can then be
combined without the cancellation of high-order polynomials.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import control
import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.linalg import schur
from scipy.signal import cont2discrete

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.linear.block_simulation import FEWEST, run_blocks
from piezo_models.linear.connections import (
    Matrices,
    in_parallel,
    in_series,
    matrices_of,
    scaled,
)

KEPT = 64
"""Number of cached modes."""

AT_ONCE = 4096
"""Number of frequencies whose states are computed together: it limits the memory."""

Section = tuple[Any, Any, Any, Any]
"""Matrices A, B, C and D of a section of the cascade."""


@dataclass(frozen=True)
class CreepDynamics:
    """Creep, eq. (4.4), with unit high-frequency gain: the product of (s + z) / (s + p)."""

    poles_rad_per_s: tuple[float, ...] = ()
    zeros_rad_per_s: tuple[float, ...] = ()
    """Positive poles p and zeros z, of equal number; empty for no creep."""

    def __post_init__(self) -> None:
        _set_positive(self, "poles_rad_per_s")
        _set_positive(self, "zeros_rad_per_s")
        if len(self.poles_rad_per_s) != len(self.zeros_rad_per_s):
            raise ValueError(
                f"creep has {len(self.poles_rad_per_s)} poles and {len(self.zeros_rad_per_s)} "
                "zeros; give one zero for each pole"
            )

    def state_space(self) -> control.StateSpace:
        """Return the continuous state space of the creep."""
        # Sections of one pole each in series: the input of each is that of the first section plus
        # the contributions of those before it.
        poles, zeros = np.array(self.poles_rad_per_s), np.array(self.zeros_rad_per_s)
        gains = zeros / poles - 1.0
        return control.ss(np.tril(np.outer(poles, gains), -1) - np.diag(poles),
                          poles[:, None], gains[None, :], [[1.0]])

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Return the complex response at the given frequencies, in the shape of `frequency_hz`."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        response = np.ones_like(s)
        for p, z in zip(self.poles_rad_per_s, self.zeros_rad_per_s, strict=True):
            response = response * (s + z) / (s + p)
        return response


@dataclass(frozen=True)
class ElectricVibrationDynamics:
    """Electric lag and vibration modes, eq. (4.3), with unit DC gain.

    Notes
    -----
    With a lag, or more modes than antiresonances, the dynamics are strictly proper: a displacement
    does not depend on the voltage applied at its instant. The default dynamics are a gain of 1,
    which follows that voltage at once, as slow recordings of other stages show.
    """

    time_constant_s: float = 0.0
    """Time constant of the electric lag, 1 / (tau s + 1); 0 for none."""
    mode_frequencies_rad_per_s: tuple[float, ...] = ()
    damping_ratios: tuple[float, ...] = ()
    """One of each for every mode."""
    antiresonance_frequencies_rad_per_s: tuple[float, ...] = ()
    antiresonance_damping_ratios: tuple[float, ...] = ()
    """One of each for every pair of zeros; no more of them than modes."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.time_constant_s) and self.time_constant_s >= 0):
            raise ValueError(
                f"time_constant_s is {self.time_constant_s}; give a positive time, or 0 for no lag"
            )
        object.__setattr__(self, "time_constant_s", float(self.time_constant_s))
        for name in (
            "mode_frequencies_rad_per_s",
            "damping_ratios",
            "antiresonance_frequencies_rad_per_s",
            "antiresonance_damping_ratios",
        ):
            _set_positive(self, name)
        modes, antiresonances = (
            len(self.mode_frequencies_rad_per_s),
            len(self.antiresonance_frequencies_rad_per_s),
        )
        if len(self.damping_ratios) != modes:
            raise ValueError(
                f"there are {modes} mode frequencies and {len(self.damping_ratios)} damping "
                "ratios; give one of each for a mode"
            )
        if len(self.antiresonance_damping_ratios) != antiresonances:
            raise ValueError(
                f"there are {antiresonances} antiresonance frequencies and "
                f"{len(self.antiresonance_damping_ratios)} antiresonance damping ratios; give one "
                "of each for an antiresonance"
            )
        if antiresonances > modes:
            raise ValueError(
                f"there are {antiresonances} antiresonances and {modes} modes; "
                "give no more antiresonances than modes"
            )

    @property
    def is_static(self) -> bool:
        """Return True if there is neither a lag nor a mode."""
        return self.time_constant_s == 0.0 and not self.mode_frequencies_rad_per_s

    def _modes(self) -> Iterator[tuple[float, float, tuple[float, float] | None]]:
        """Yield w and zeta of each mode, and the pair of zeros of its section or None."""
        antiresonances: list[tuple[float, float] | None] = list(
            zip(
                self.antiresonance_frequencies_rad_per_s,
                self.antiresonance_damping_ratios,
                strict=True,
            )
        )
        antiresonances += [None] * (len(self.mode_frequencies_rad_per_s) - len(antiresonances))
        return zip(
            self.mode_frequencies_rad_per_s, self.damping_ratios, antiresonances, strict=True
        )

    def state_space(self, parallel_modes: Sequence[Any] = ()) -> control.StateSpace:
        """Return the continuous state space of the lag and the modes.

        Additional parallel modes take their share of the displacement; the others keep the rest.
        """
        lag: list[Section] = []
        if self.time_constant_s > 0.0:
            rate = 1.0 / self.time_constant_s
            lag = [([[-rate]], [[rate]], [[1.0]], [[0.0]])]
        modes = self._series_of_modes()
        if parallel_modes:
            share = 1.0 - sum(mode.participation for mode in parallel_modes)
            modes = in_parallel([scaled(share, modes), *map(_branch, parallel_modes)])
        return control.ss(*in_series([_cascade(lag), modes]))

    def _series_of_modes(self) -> Matrices:
        sections: list[Section] = []
        for w, zeta, antiresonance in self._modes():
            position, velocity, direct = 1.0, 0.0, 0.0
            if antiresonance is not None:
                wz, zeta_z = antiresonance
                direct = (w / wz) ** 2
                position = 1.0 - direct
                velocity = 2.0 * (zeta_z * w / wz - zeta * direct)
            sections.append(
                (
                    [[0.0, w], [-w, -2.0 * zeta * w]],
                    [[0.0], [w]],
                    [[position, velocity]],
                    [[direct]],
                )
            )
        return _cascade(sections)

    def response(self, frequency_hz: ArrayLike, parallel_modes: Sequence[Any] = ()) -> ComplexArray:
        """Return the complex response at frequencies in Hz, in their shape; see `state_space`."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        response = np.ones_like(s)
        for w, zeta, antiresonance in self._modes():
            response = response / _quadratic(s, w, zeta)
            if antiresonance is not None:
                response = response * _quadratic(s, *antiresonance)
        response = (1.0 - sum(mode.participation for mode in parallel_modes)) * response
        for mode in parallel_modes:
            response = response + mode.branch_response(s)
        return response / (self.time_constant_s * s + 1.0)


@lru_cache(maxsize=KEPT)
def _branch(mode: Any) -> Matrices:
    """Return the mode's part of the displacement; of other packages, its part at rest.

    It is cached, as a fit changes one mode at a time, and must not be changed.
    """
    if hasattr(mode, "branch"):
        return matrices_of(mode.branch())
    return scaled(mode.participation, matrices_of(mode.state_space()))


def _quadratic(s: ComplexArray, frequency: float, damping: float) -> ComplexArray:
    ratio = s / frequency
    return ratio * ratio + 2.0 * damping * ratio + 1.0


def _set_positive(instance: object, name: str) -> None:
    values = tuple(float(value) for value in getattr(instance, name))
    if not all(np.isfinite(value) and value > 0 for value in values):
        raise ValueError(f"{name} is {values}; give positive numbers")
    object.__setattr__(instance, name, values)


def _cascade(sections: Sequence[Section]) -> Matrices:
    """Return the series connection, the first section first."""
    return in_series(
        [(np.array(a), np.array(b), np.array(c), np.array(d)) for a, b, c, d in sections])


def zoh(system: control.StateSpace, sample_period_s: float) -> control.StateSpace:
    """Return the exact discrete system for an input held over each sample period.

    Parameters
    ----------
    system : control.StateSpace
        Continuous system; its states are kept.

    Returns
    -------
    control.StateSpace
        Discrete system with `dt` = `sample_period_s`.

    Raises
    ------
    ValueError
        If the system is discrete already, or the sample period is not positive.

    Examples
    --------
    >>> import control
    >>> lag = control.ss(-100.0, 100.0, 1.0, 0.0)
    >>> print(f"{zoh(lag, 1e-3).A[0, 0]:.4f}")      # exp(-0.1)
    0.9048
    """
    if not system.isctime(strict=False):
        raise ValueError("the system is discrete already; give the continuous one")
    if not (np.isfinite(sample_period_s) and sample_period_s > 0):
        raise ValueError(f"sample_period_s is {sample_period_s}; give a positive time")
    if system.nstates == 0:
        return control.ss(system.A, system.B, system.C, system.D, sample_period_s)
    *matrices, _ = cont2discrete(matrices_of(system), sample_period_s, "zoh")
    return control.ss(*matrices, sample_period_s)


def answering_means(system: control.StateSpace, sample_period_s: float) -> control.StateSpace:
    """Return a system whose response to held means of an input is that to the input itself.

    Holding the means of an input over periods h, in s, smooths it, by 1 + (s h)^2 / 12 up to the
    third power of s h. The outputs y become y - h C z (1 - 3 z / 2) / (1 - z / 2)^3 x' / 12, with z
    = A h. This cancels the smoothing to the same order, keeps the DC gain, and is bounded for any
    stable pole. The system is continuous; its states are kept.
    """
    a, b, c, d = matrices_of(system)
    none, z = np.eye(len(a)), sample_period_s * a
    damped = np.linalg.inv(none - 0.5 * z)
    of_slope = sample_period_s / 12.0 * c @ z @ (none - 1.5 * z) @ damped @ damped @ damped
    return control.ss(a, b, c - of_slope @ a, d - of_slope @ b)


def zoh_response(system: control.StateSpace, frequency_hz: ArrayLike,
                 sample_period_s: float) -> ComplexArray:
    """Return the response of the ZOH-sampled system, its transfer function at exp(j 2 pi f T).

    The system is continuous, with one input and one output. The response has the shape of the
    frequencies.
    """
    discrete = zoh(system, sample_period_s)
    _check_single(discrete)
    frequency = np.asarray(frequency_hz, dtype=float)
    z = np.exp(2j * np.pi * frequency.ravel() * sample_period_s)
    return transfer_at(discrete, z).reshape(frequency.shape)[()]


def transfer_at(system: control.StateSpace, z: ComplexArray) -> ComplexArray:
    """Return the transfer function of a system with one input and one output at some z, (n,)."""
    triangle, turned = schur(system.A, output="complex")
    entering, leaving = turned.conj().T @ system.B[:, 0], system.C[0] @ turned
    response = np.full(z.size, system.D[0, 0], dtype=complex)
    for start in range(0, z.size, AT_ONCE):
        part = z[start : start + AT_ONCE]
        states = np.empty((len(triangle), part.size), dtype=complex)
        for row in reversed(range(len(triangle))):
            behind = triangle[row, row + 1 :] @ states[row + 1 :]
            states[row] = (entering[row] + behind) / (part - triangle[row, row])
        response[start : start + AT_ONCE] += leaving @ states
    return response


def equilibrium_state(system: control.StateSpace, held_input: float = 1.0) -> FloatArray:
    """Return the state in which a continuous, stable system rests under a constant input, (n,).

    The ZOH-sampled system has the same states and therefore the same equilibrium.
    """
    return np.linalg.solve(system.A, -held_input * system.B[:, 0])


def simulate_linear(discrete_system: control.StateSpace, input: ArrayLike,
                    initial_state: ArrayLike | None = None) -> FloatArray:
    """Return y[n] = C x[n] + D v[n], (N,), of a system with x[n + 1] = A x[n] + B v[n].

    Parameters
    ----------
    discrete_system : control.StateSpace
        Discrete system with one input and one output.
    input : (N,) array_like
    initial_state : (n,) array_like, optional
        State at the first sample; zero by default.

    Examples
    --------
    >>> import control
    >>> lag = zoh(control.ss(-100.0, 100.0, 1.0, 0.0), 1e-3)
    >>> print(np.round(simulate_linear(lag, np.ones(4)), 4))
    [0.     0.0952 0.1813 0.2592]
    """
    states = discrete_system.nstates
    state = np.zeros(states) if initial_state is None else initial_state
    return continue_linear(discrete_system, input, state)[0]


def continue_linear(discrete_system: control.StateSpace, input: ArrayLike,
                    state: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the output of `simulate_linear`, (N,), and the state at the sample after the last one.

    The state at the first sample, (n,), is not changed.
    """
    _check_single(discrete_system)
    if not discrete_system.isdtime(strict=True):
        raise ValueError("the system is continuous; sample it with zoh() first")
    samples = np.ascontiguousarray(input, dtype=float)
    state = np.array(state, dtype=float)
    if samples.ndim != 1:
        raise ValueError(f"the input has {samples.ndim} dimensions; give one sequence")
    if state.shape != (discrete_system.nstates,):
        raise ValueError(
            f"the state has shape {state.shape}; the system has {discrete_system.nstates} states"
        )
    a, direct = np.ascontiguousarray(discrete_system.A), discrete_system.D[0, 0]
    b, c = (np.ascontiguousarray(each) for each in (discrete_system.B[:, 0], discrete_system.C[0]))
    output, done = np.empty(samples.size), 0
    if state.size and samples.size >= FEWEST:
        done = run_blocks(a, b, c, direct, samples, state, output)
    _run(np.ascontiguousarray(a.T), b, c, direct, samples[done:], state, output[done:])
    return output, state


def _check_single(system: control.StateSpace) -> None:
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ValueError(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs; "
            "give one with a single input and output"
        )


@njit(cache=True, nogil=True)
def _run(transposed: FloatArray, gains: FloatArray, weights: FloatArray, direct: float,
         samples: FloatArray, state: FloatArray, output: FloatArray) -> None:
    size = state.size
    following = np.empty(size)
    for n in range(samples.size):
        v = samples[n]
        y = direct * v
        for i in range(size):
            following[i] = gains[i] * v
        for j in range(size):
            x = state[j]
            y += weights[j] * x
            for i in range(size):
                following[i] += transposed[j, i] * x
        for i in range(size):
            state[i] = following[i]
        output[n] = y
