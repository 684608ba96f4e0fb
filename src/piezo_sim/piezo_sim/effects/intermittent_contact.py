# SPDX-License-Identifier: BSD-3-Clause
"""A joint that loosens at random times, and transmits less of the motion while it is loose."""

from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.random_stream import EventStream, bits_for
from piezo_sim.plant.state_runner import StateRunner


@dataclass(frozen=True)
class IntermittentContact(Bounded):
    """While loose, a share of the displacement from the joint's own position is lost.

    Tight and loose times are exponentially distributed; it starts tight.
    """

    name: ClassVar[str] = "intermittent_contact"

    lost_share: float = parameter("1")
    joint_um: float = parameter("um")
    mean_tight_time_s: float = parameter("s", POSITIVE)
    mean_loose_time_s: float = parameter("s", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0.0 <= self.lost_share <= 1.0, self, "lost_share must be between 0 and 1.")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the times from the seed; the joint is tight at rest."""
        mean_samples = [time_s / surroundings.sample_period_s
                        for time_s in (self.mean_tight_time_s, self.mean_loose_time_s)]
        events = EventStream(bits_for(self.name, surroundings.seed))
        events.wait(mean_samples[False])

        def pass_on(samples: FloatArray, loose: bool) -> tuple[bool]:
            done = 0
            while (position := events.within(samples.size)) is not None:
                self._lose(samples[done:position], loose)
                done, loose = position, not loose
                events.wait(mean_samples[loose])
            self._lose(samples[done:], loose)
            events.advance(samples.size)
            return (loose,)

        return StateRunner(pass_on, lambda level: ((False,), level))

    def _lose(self, samples: FloatArray, loose: bool) -> None:
        if loose:
            samples -= self.lost_share * (samples - self.joint_um)
