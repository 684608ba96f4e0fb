# SPDX-License-Identifier: BSD-3-Clause
"""Common base of all effects of the plant: parameters with units, and the interface of runners."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from piezo_common.arrays import FloatArray


class PlantConfigError(ValueError):
    """A plant file is invalid; the message says where, and what to do."""


@dataclass(frozen=True)
class Surroundings:
    """Properties of the plant that an effect needs."""

    sample_period_s: float
    """Period of the sample clock in s."""
    rest_voltage_v: float
    """Voltage in V at which the stage has rested."""
    seed: int
    """Seed of all random numbers."""


class Runner(Protocol):
    """A started effect, which holds the state and processes samples."""

    def rest(self, level: float) -> float:
        """Set the equilibrium state at the constant input `level`; return the output."""

    def apply(self, samples: FloatArray) -> None:
        """Replace the input samples, float64 of shape (N,), by the output samples."""


class Effect(Protocol):
    """Parameters of one effect, a frozen dataclass whose fields are made by `parameter`.

    An effect is a `StartedEffect`, or a `piezo_sim.plant.linear_effects.LinearEffect`.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    name: ClassVar[str]


@runtime_checkable
class StartedEffect(Effect, Protocol):
    """An effect that processes samples by its own runner."""

    def start(self, surroundings: Surroundings) -> Runner:
        """Return the runner of this effect."""


POSITIVE, NOT_NEGATIVE = "must be positive.", "must not be negative."


def parameter(unit: str, sign: str = "") -> Any:
    """Declare a parameter of an effect, with the unit that the plant file must state.

    The sign, `POSITIVE` or `NOT_NEGATIVE`, is what a `Bounded` effect requires of it, and of each
    number of a list.
    """
    return dataclasses.field(metadata={"unit": unit, "sign": sign})


@dataclass(frozen=True)
class Bounded:
    """Base of effects, which checks the signs of their parameters."""

    name: ClassVar[str]

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            sign, numbers = field.metadata["sign"], np.ravel(getattr(self, field.name))
            good = numbers > 0.0 if sign == POSITIVE else numbers >= 0.0
            require(not sign or bool(good.all()), self, f"{field.name} {sign}")


def require(condition: bool, effect: Effect, sentence: str) -> None:
    """Raise PlantConfigError if parameters of an effect contradict each other or physics."""
    if not condition:
        raise PlantConfigError(f"{effect.name}: {sentence}")
