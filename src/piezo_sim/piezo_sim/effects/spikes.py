# SPDX-License-Identifier: BSD-3-Clause
"""Single outliers, as from glitches of a converter or a cable."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import EventStream, bits_for
from piezo_sim.plant.state_runner import StateRunner


@dataclass(frozen=True)
class Spikes(Bounded):
    """Spikes at random instants, of either sign, with log-normal heights about a typical one."""

    name: ClassVar[str] = "spikes"

    rate_per_s: float = parameter("1/s", POSITIVE)
    height_um: float = parameter("um")
    height_spread: float = parameter("1", NOT_NEGATIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the instants from the seed; spikes do not change the rest."""
        mean_samples = 1.0 / (self.rate_per_s * surroundings.sample_period_s)
        events = EventStream(bits_for(self.name, surroundings.seed))
        events.wait(mean_samples)

        def add(samples: FloatArray) -> tuple[()]:
            while (position := events.within(samples.size)) is not None:
                generator = events.generator
                height_um = self.height_um * np.exp(
                    self.height_spread * generator.standard_normal())
                samples[position] += height_um if generator.random() < 0.5 else -height_um
                events.wait(mean_samples)
            events.advance(samples.size)
            return ()

        return StateRunner(add, lambda level: ((), level))
