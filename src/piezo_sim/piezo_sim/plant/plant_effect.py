# SPDX-License-Identifier: BSD-3-Clause
"""What every effect of the plant has in common: parameters with units, and a place in the chain."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

from piezo_common.arrays import FloatArray


class PlantConfigError(ValueError):
    """A plant file that cannot be used; the message says where and what to do."""


@dataclass(frozen=True)
class Surroundings:
    """What an effect needs to know of the plant around it.

    Attributes
    ----------
    sample_period_s : float
        Period of the sample clock.
    rest_voltage_v : float
        Voltage at which the stage has rested for long.
    seed : int
        Seed of everything random.
    """

    sample_period_s: float
    rest_voltage_v: float
    seed: int


class Runner(Protocol):
    """A started effect: it holds the state and passes samples on."""

    def rest(self, level: float) -> float:
        """Take the equilibrium state at the constant input `level`; return the output."""

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
    """An effect that passes samples on by a runner of its own."""

    def start(self, surroundings: Surroundings) -> Runner:
        """Make the runner of this effect."""


def parameter(unit: str) -> Any:
    """Declare a parameter of an effect, with the unit that the plant file must state."""
    return dataclasses.field(metadata={"unit": unit})


def require(condition: bool, effect: Effect, sentence: str) -> None:
    """Refuse an effect whose parameters contradict each other or physics.

    Raises
    ------
    PlantConfigError
        If `condition` does not hold.
    """
    if not condition:
        raise PlantConfigError(f"{effect.name}: {sentence}")
