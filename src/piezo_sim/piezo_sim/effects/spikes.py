# SPDX-License-Identifier: BSD-3-Clause
"""Single outliers, as from glitches of a converter or a cable."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import EventStream, bits_for


@dataclass(frozen=True)
class Spikes(Bounded):
    """Spikes at random instants, of either sign, with log-normal heights about a typical one."""

    name: ClassVar[str] = "spikes"

    rate_per_s: float = parameter("1/s", POSITIVE)
    height_um: float = parameter("um")
    height_spread: float = parameter("1", NOT_NEGATIVE)

    def start(self, surroundings: Surroundings) -> "SpikesRunner":
        """Start the instants from the seed."""
        return SpikesRunner(self, surroundings)


class SpikesRunner:
    """Spikes with the instant of the next one."""

    def __init__(self, effect: Spikes, surroundings: Surroundings) -> None:
        self._effect = effect
        self._mean_samples = 1.0 / (effect.rate_per_s * surroundings.sample_period_s)
        self._events = EventStream(bits_for(effect.name, surroundings.seed))
        self._events.wait(self._mean_samples)

    def rest(self, level: float) -> float:
        """Return the level unchanged, as spikes do not change it."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Add spikes to displacements."""
        while (position := self._events.within(samples.size)) is not None:
            generator, effect = self._events.generator, self._effect
            height_um = effect.height_um * np.exp(
                effect.height_spread * generator.standard_normal()
            )
            samples[position] += height_um if generator.random() < 0.5 else -height_um
            self._events.wait(self._mean_samples)
        self._events.advance(samples.size)
