# SPDX-License-Identifier: BSD-3-Clause
"""Displacement over voltage in physical parameters, and its numbers of components."""

from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@dataclass(frozen=True)
class ResponseModel:
    """Displacement over voltage in physical parameters."""

    gain: float
    """Gain at a frequency between creep and modes, in the unit of the measured response."""
    delay_s: float
    creep: CreepDynamics
    dynamics: ElectricVibrationDynamics

    parallel: tuple[VibrationMode, ...] = ()
    """Parallel modes, which place zeros anywhere in the plane."""

    def linear(self) -> control.StateSpace:
        """Continuous `control.StateSpace` without gain and delay."""
        return self.creep.state_space() * self.dynamics.state_space(self.parallel)

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Complex response at the given frequencies, in the shape of `frequency_hz`."""
        delay = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=float) * self.delay_s)
        return (
            self.gain * delay * self.creep.response(frequency_hz)
            * self.dynamics.response(frequency_hz, self.parallel)
        )

    def error(self, measured: FrequencyResponse) -> float:
        """Relative error: the norm of the difference over that of the measured response."""
        difference = self.response(measured.frequency_hz) - measured.gain
        return float(np.linalg.norm(difference) / np.linalg.norm(measured.gain))


@dataclass(frozen=True)
class ResponseOrder:
    """Numbers of components."""

    creep_pairs: int | None
    modes: int | None
    antiresonances: int | None
    """None in a request: as many as the data justify."""
    parallel: int = 0
    """Number of parallel modes. In a request they count as modes if the number of antiresonances is
    open."""
    is_coupled: bool = False
    """Whether a parallel mode has a part proportional to its velocity."""
    has_lag: bool = True
    has_delay: bool = True

    def __post_init__(self) -> None:
        for name in ("creep_pairs", "modes", "antiresonances"):
            number = getattr(self, name)
            if number is not None and number < 0:
                raise ValueError(f"{name} is {number}: give 0 or more")

    @property
    def states(self) -> int:
        """Number of states of the rational part."""
        return (self.creep_pairs or 0) + self.has_lag + 2 * ((self.modes or 0) + self.parallel)

    def __str__(self) -> str:
        text = f"{self.creep_pairs}+{self.modes}-{self.antiresonances}"
        text += f"+{self.parallel}" * bool(self.parallel) + " coupled" * self.is_coupled
        return text + " no lag" * (not self.has_lag) + " no delay" * (not self.has_delay)

    def grants(self, order: "ResponseOrder") -> bool:
        """Return whether an order meets this request."""
        if self.antiresonances is not None and (order.parallel or order.is_coupled):
            return False
        numbers = (order.creep_pairs, (order.modes or 0) + order.parallel, order.antiresonances)
        return all(wanted is None or wanted == number for wanted, number in zip(
            (self.creep_pairs, self.modes, self.antiresonances), numbers, strict=True))


ANY_ORDER = ResponseOrder(None, None, None)
