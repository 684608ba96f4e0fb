# SPDX-License-Identifier: BSD-3-Clause
"""A simulated stage that differs in form from its model, tracked by feedforward and monitored."""

from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.model_monitor import Suspicion
from piezo_identification.monitoring.stage_monitor import StageMonitor
from piezo_identification.monitoring.usual_error import known_error
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.sample_block import Flag
from piezo_sim.plant.plant_file import PlantConfig
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.changes_in_operation.reference_kinds import CLOCK, KINDS, RUN_S, plan_of

PART_SAMPLES = 4000
BACK_S, REST_S = 0.1, 0.15
"""Durations of the ramp back to 0 V after a run, and of the rest there (s)."""

LATER_KINDS = 5
"""Number of kinds of references that are tracked only in the second half."""


@dataclass(frozen=True)
class Report:
    """A change that was reported while nothing changed."""

    kind: str
    """Kind of the reference."""
    suspicion: Suspicion


@dataclass(eq=False)
class WatchedStage:
    """A stage, its monitor, and the number of the next sample."""

    plant: PlantConfig
    identified: IdentifiedModel

    seed: int = 1
    """Seed of the sensor's noise."""
    stage: SimulatedStage = field(init=False)
    monitor: StageMonitor = field(init=False)
    next_sample: int = 0

    def __post_init__(self) -> None:
        self.stage = opened(self.plant, self.seed)
        self.monitor = StageMonitor(self.identified.model, CLOCK.sample_rate_hz,
                                    known=known_error(self.identified))

    def copy(self) -> "WatchedStage":
        """Return an independent copy of stage and monitor."""
        return deepcopy(self, {id(self.identified): self.identified})

    def play(self, voltage_v: FloatArray, added_um: FloatArray | None = None,
             flags: int = int(Flag.TRACKING)) -> list[Suspicion]:
        """Play voltages, to which a change may add displacements; return reported changes."""
        raised: list[Suspicion] = []
        for begin in range(0, voltage_v.size, PART_SAMPLES):
            part = slice(begin, begin + PART_SAMPLES)
            measured_um = np.asarray(self.stage.exchange(voltage_v[part]))
            if added_um is not None:
                measured_um = measured_um + added_um[part]
            raised += self.monitor.take(self.next_sample, CLOCK.sample_period_s, voltage_v[part],
                                        measured_um, flags)
            self.next_sample += measured_um.size
        return raised

    def run(self, kind: str, draw: int) -> list[Suspicion]:
        """Track a reference from rest to rest; return the reported changes."""
        voltage_v = plan_of(kind, self.identified.model, draw).voltage_v(0, samples(RUN_S))
        raised = self.play(voltage_v)
        self.play(np.append(np.linspace(voltage_v[-1], 0.0, samples(BACK_S)),
                            np.zeros(samples(REST_S))), flags=0)
        return raised


def opened(plant: PlantConfig, seed: int) -> SimulatedStage:
    """Return a simulated stage at rest."""
    stage = SimulatedStage(plant, seed, CLOCK.sample_rate_hz)
    stage.open()
    return stage


def samples(duration_s: float) -> int:
    """Return the number of clock samples in a time (s)."""
    return round(duration_s * CLOCK.sample_rate_hz)


def watch_unchanged(watched: WatchedStage, hours: float) -> list[Report]:
    """Track references in random order for simulated hours on a stage that does not change.

    The last kinds of references are tracked only in the second half.
    """
    random, kinds = np.random.default_rng(0), list(KINDS)
    runs, reports = round(3600.0 * hours / RUN_S), []
    for number in range(runs):
        known = kinds if 2 * number >= runs else kinds[:-LATER_KINDS]
        kind = known[random.integers(len(known))]
        reports += [Report(kind, found) for found in watched.run(kind, int(random.integers(100)))]
    return reports
