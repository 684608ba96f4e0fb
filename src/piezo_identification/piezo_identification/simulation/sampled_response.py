# SPDX-License-Identifier: BSD-3-Clause
"""Response of the linear part at the samples of a recording, with delays within a sample."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import takewhile

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import Effect
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.linear.connections import matrices_of
from piezo_models.linear.dynamics import (
    answering_means,
    equilibrium_state,
    simulate_linear,
    transfer_at,
    zoh,
)
from piezo_models.linear.outputs_at import simulate_linear_at

KEPT = 256
"""Number of cached sampled systems; a fit uses some dozens for all its recordings."""


def leading_lags(
    effects: Sequence[Effect], samples: int,
) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Separate the leading effects that can be put in series with a linear system.

    Slow samples do not show all motion between them, so lags are exact only in series. The effects
    are those after the system, in the order of the signal. A measured displacement is the mean of
    `samples` samples; a delay acts on the means if there are several. Return the leading lags, and
    the other effects, which act on the sampled displacement.
    """
    kinds = (Delay, SensorLag) if samples == 1 else (SensorLag,)
    lags = tuple(takewhile(lambda effect: type(effect) in kinds, effects))
    return lags, tuple(effects[len(lags) :])


def behind_lags(
    system: control.StateSpace, lags: Sequence[Effect],
) -> tuple[control.StateSpace, float]:
    """Put `leading_lags` in series after a continuous system; return it and their total delay."""
    delays_s = [lag.delay_s for lag in lags if type(lag) is Delay]
    for lag in lags:
        if type(lag) is SensorLag:
            system = lag.lag() * system
    return system, sum(delays_s)


class SampledSystem:
    """A continuous system sampled like a recording that begins in equilibrium.

    Each of the inputs, (N parts,), is held for a part of a sample period, and each displacement is
    the mean of `samples` samples. The delay after the system is exact for any fraction of a sample
    period. If it is negative, the response is read after the input changes, and the last input is
    held. For means, the delay must be 0, and a sample period has one part. The system may have
    several outputs.
    """

    def __init__(self, system: control.StateSpace, sample_period_s: float, samples: int,
                 delay_s: float = 0.0, parts: int = 1) -> None:
        self._discrete, self._late = _sampled(
            *(matrix.tobytes() for matrix in matrices_of(system)), sample_period_s / parts,
            samples, delay_s, parts > 1)
        self._held, self._parts = equilibrium_state(system), parts

    def response(self, input_um: FloatArray) -> FloatArray:
        """Return the only output at all samples, (N,)."""
        delayed, early = min(max(self._late, 0), input_um.size), max(-self._late, 0)
        played_um = input_um
        if delayed or early:
            played_um = np.concatenate([
                np.full(delayed, input_um[0]), input_um[: input_um.size - delayed],
                np.full(early, input_um[-1])])
        return simulate_linear(
            self._discrete, played_um, input_um[0] * self._held)[early :: self._parts]

    def response_over(self, turn: FloatArray) -> ComplexArray:
        """Return the only output over the input at frequencies, in turns per input, (n,)."""
        z = np.exp(2j * np.pi * turn)
        return transfer_at(self._discrete, z) * z ** -float(self._late)

    def response_at(self, input_um: FloatArray, at: NDArray[np.intp]) -> FloatArray:
        """Return all outputs at a few sorted samples, (n, outputs), which costs less."""
        read = at * self._parts - self._late
        beyond = int(read[-1]) + 1 - input_um.size if read.size else 0
        if beyond > 0:
            input_um = np.concatenate([input_um, np.full(beyond, input_um[-1])])
        # Before the first sample, the system was in equilibrium as it is there.
        return simulate_linear_at(
            self._discrete, input_um, input_um[0] * self._held, np.maximum(read, 0))


@lru_cache(maxsize=KEPT)
def _sampled(a: bytes, b: bytes, c: bytes, d: bytes, sample_period_s: float, samples: int,
             delay_s: float, of_means: bool) -> tuple[control.StateSpace, int]:
    """Return the discrete system of some matrices, and its delay in whole sample periods.

    It is cached, as one system is often used for many recordings, and must not be changed.
    """
    gains, direct = np.frombuffer(b), np.frombuffer(d)
    system = control.ss(
        np.frombuffer(a).reshape(gains.size, gains.size), gains[:, None],
        np.frombuffer(c).reshape(direct.size, gains.size), direct[:, None])
    if of_means:
        system = answering_means(system, sample_period_s)
    if delay_s != 0.0:
        return delayed_zoh(system, sample_period_s, delay_s)
    return mean_zoh(system, sample_period_s, samples), 0


def delayed_zoh(
    system: control.StateSpace, sample_period_s: float, delay_s: float,
) -> tuple[control.StateSpace, int]:
    """Return the discrete system for a held input and a delayed output.

    The second result is the further delay of the output in whole sample periods, which may be
    negative.
    """
    discrete = zoh(system, sample_period_s)
    late, part = divmod(delay_s / sample_period_s, 1.0)
    if part == 0.0:
        return discrete, int(late)
    # The measured output is that within the previous sample period.
    middle = zoh(system, (1.0 - part) * sample_period_s)
    return control.ss(
        discrete.A, discrete.B, system.C @ middle.A, system.C @ middle.B + system.D,
        sample_period_s,
    ), int(late) + 1


def mean_zoh(
    system: control.StateSpace, sample_period_s: float, samples: int,
) -> control.StateSpace:
    """Return the discrete system whose output is the mean of the samples in each held period.

    The input is held for `sample_period_s`. In that time there are `samples` equally spaced output
    samples, the first at its start.
    """
    fine = zoh(system, sample_period_s / samples)
    if samples == 1:
        return fine
    # The held input is appended to the states, so that a power advances both.
    states = system.nstates
    step = np.block([[fine.A, fine.B], [np.zeros((1, states)), np.ones((1, 1))]])
    power, summed = _power_and_sum(step, samples)
    output = np.hstack([fine.C, fine.D]) @ summed / samples
    return control.ss(power[:states, :states], power[:states, states:], output[:, :states],
                      output[:, states:], sample_period_s)


def _power_and_sum(step: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return a power of a matrix, and the sum of all lower powers, by repeated doubling."""
    none = np.eye(len(step))
    power, summed = none, np.zeros_like(step)
    for digit in f"{count:b}":
        power, summed = power @ power, summed + power @ summed
        if digit == "1":
            power, summed = power @ step, none + step @ summed
    return power, summed
