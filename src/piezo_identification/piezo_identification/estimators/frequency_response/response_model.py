# SPDX-License-Identifier: BSD-3-Clause
"""Displacement over voltage in physical parameters, and the numbers of its components."""

from dataclasses import astuple, dataclass

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@dataclass(frozen=True)
class ResponseModel:
    """Displacement over voltage in physical parameters.

    Parameters
    ----------
    gain : float
        Between creep and modes, in the unit of the measured response.
    delay_s : float
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
    beside : tuple of VibrationMode
        Modes that add a part of their own, which puts zeros anywhere in the plane.
    """

    gain: float
    delay_s: float
    creep: CreepDynamics
    dynamics: ElectricVibrationDynamics
    beside: tuple[VibrationMode, ...] = ()

    @property
    def states(self) -> int:
        """States of the rational part."""
        modes = len(self.dynamics.damping_ratios) + len(self.beside)
        return len(self.creep.poles_rad_per_s) + 1 + 2 * modes

    def linear(self) -> control.StateSpace:
        """Continuous `control.StateSpace` without gain and delay."""
        return self.creep.state_space() * self.dynamics.state_space(self.beside)

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Complex response at the given frequencies, in the shape of `frequency_hz`."""
        delay = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=float) * self.delay_s)
        return (
            self.gain * delay * self.creep.response(frequency_hz)
            * self.dynamics.response(frequency_hz, self.beside)
        )

    def error(self, measured: FrequencyResponse) -> float:
        """Relative error: the norm of the difference over that of the measured response."""
        difference = self.response(measured.frequency_hz) - measured.gain
        return float(np.linalg.norm(difference) / np.linalg.norm(measured.gain))


@dataclass(frozen=True)
class ResponseOrder:
    """Numbers of components.

    Parameters
    ----------
    creep_pairs, modes, antiresonances : int or None
        None in a request: as many as the data justify.
    beside : int
        Modes side by side with one or more in series, which is not for requests: they are sought
        where neither modes nor antiresonances are asked for.
    """

    creep_pairs: int | None
    modes: int | None
    antiresonances: int | None
    beside: int = 0

    @property
    def states(self) -> int:
        """States of the rational part, the electric lag among them."""
        return (self.creep_pairs or 0) + 1 + 2 * ((self.modes or 0) + self.beside)

    def __str__(self) -> str:
        text = f"{self.creep_pairs}+{self.modes}-{self.antiresonances}"
        return f"{text}+{self.beside}" if self.beside else text

    def grants(self, order: "ResponseOrder") -> bool:
        """Whether an order is what this one requests."""
        return all(
            wanted is None or wanted == number
            for wanted, number in zip(astuple(self)[:3], astuple(order)[:3], strict=True)
        )


ANY_ORDER = ResponseOrder(None, None, None)
