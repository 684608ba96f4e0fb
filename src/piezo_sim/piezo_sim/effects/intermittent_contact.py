# SPDX-License-Identifier: BSD-3-Clause
"""A joint that loosens at random times, and transmits less of the motion while it is loose."""

from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.random_stream import EventStream, bits_for


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

    def start(self, surroundings: Surroundings) -> "IntermittentContactRunner":
        """Start the times from the seed."""
        return IntermittentContactRunner(self, surroundings)


class IntermittentContactRunner:
    """Intermittent contact with its state and the instant of the next change."""

    def __init__(self, effect: IntermittentContact, surroundings: Surroundings) -> None:
        self._effect = effect
        self._mean_samples = {
            False: effect.mean_tight_time_s / surroundings.sample_period_s,
            True: effect.mean_loose_time_s / surroundings.sample_period_s,
        }
        self._loose = False
        self._events = EventStream(bits_for(effect.name, surroundings.seed))
        self._events.wait(self._mean_samples[self._loose])

    def rest(self, level: float) -> float:
        """Return the level unchanged, because the joint is tight at rest."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace displacements of the drive by those behind the joint."""
        done = 0
        while (position := self._events.within(samples.size)) is not None:
            self._pass_on(samples[done:position])
            done = position
            self._loose = not self._loose
            self._events.wait(self._mean_samples[self._loose])
        self._pass_on(samples[done:])
        self._events.advance(samples.size)

    def _pass_on(self, samples: FloatArray) -> None:
        if self._loose:
            samples -= self._effect.lost_share * (samples - self._effect.joint_um)
