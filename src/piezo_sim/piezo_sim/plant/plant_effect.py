# SPDX-License-Identifier: BSD-3-Clause
"""Common base of all effects of the plant: parameters with units, and the interface of runners."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

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


def parameter(unit: str) -> Any:
    """Declare a parameter of an effect, with the unit that the plant file must state."""
    return dataclasses.field(metadata={"unit": unit})


def require(condition: bool, effect: Effect, sentence: str) -> None:
    """Check that the parameters of an effect agree with each other and with physics.

    Raises
    ------
    PlantConfigError
        If `condition` does not hold.
    """
    if not condition:
        raise PlantConfigError(f"{effect.name}: {sentence}")
