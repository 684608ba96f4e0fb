# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage with a change at a time, tracked by feedforward and watched by a model."""

from dataclasses import dataclass

import numpy as np

from piezo_controller.references.reference import Reference
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_identification.monitoring.model_monitor import Suspicion
from piezo_identification.monitoring.stage_monitor import StageMonitor
from piezo_models.cascade import StageModel
from piezo_recorder.sample_block import Flag
from piezo_sim.effects.loaded_mode import LoadedMode
from piezo_sim.effects.placement import add_effect
from piezo_sim.effects.switched_heat import SwitchedHeat
from piezo_sim.plant.plant_effect import Effect
from piezo_sim.plant.plant_file import read_plant
from piezo_sim.simulated_stage import SimulatedStage

CLOCK = StageClock(sample_rate_hz=4000.0, samples_per_tick=4)
"""A tenth of the usual clock: an hour of it is computed in a minute."""

REFERENCE = Reference("multi_frequency", (10.0, 170.0), (40.0, 4.0), (0.0, 1.0), 57.0)
CHANGE_S = 30.0
AFTER_S = 60.0
HOUR_S = 3600.0
PART_SAMPLES = 4000
_MODE = 2846.0, 0.68535

CHANGES: dict[str, Effect] = {
    "first mode 3 % faster": LoadedMode(*_MODE, 1.03**-2 - 1.0, 0.0, CHANGE_S),
    "load: a mass of 5 % of the first mode's": LoadedMode(*_MODE, 0.05, 0.0, CHANGE_S),
    "load: a spring of 0.5 % of the first mode's": LoadedMode(*_MODE, 0.0, 0.005, CHANGE_S),
    "drift that begins with 2 nm/s": SwitchedHeat(0.2, 100.0, CHANGE_S),
}


@dataclass(frozen=True)
class Watched:
    """What the monitor said of one run.

    Attributes
    ----------
    change : str
        Empty for none.
    watched_s : float
        Stage time of the run.
    """

    change: str
    watched_s: float
    raised: tuple[Suspicion, ...]

    @property
    def false_alarms(self) -> int:
        """Count the alarms before the change, or all without one."""
        return sum(not self.change or found.at_s < CHANGE_S for found in self.raised)

    @property
    def found(self) -> list[Suspicion]:
        """Return the alarms at the time of the first one since the change."""
        later = [found for found in self.raised if found.at_s >= CHANGE_S]
        return [found for found in later if found.at_s == later[0].at_s]


def watch(model: StageModel, change: str, seed: int, duration_s: float = 0.0) -> Watched:
    """Track with a model's feedforward, and let it watch.

    Parameters
    ----------
    change : str
        Of `CHANGES`; empty for none.
    seed : int
        Of the sensor's noise.
    duration_s : float
        0 for as long as the change is looked for.
    """
    duration_s = duration_s or CHANGE_S + AFTER_S
    plant = read_plant()
    plan = plan_mode("feedforward", REFERENCE, model, CLOCK, duration_s)
    stage = SimulatedStage(
        add_effect(plant, CHANGES[change]) if change else plant, seed, CLOCK.sample_rate_hz)
    stage.open()
    monitor = StageMonitor(model, CLOCK.sample_rate_hz)
    raised: list[Suspicion] = []
    for first in range(0, round(duration_s * CLOCK.sample_rate_hz), PART_SAMPLES):
        voltage_v = plan.voltage_v(first, PART_SAMPLES)
        displacement_um = np.asarray(stage.exchange(voltage_v))
        raised += monitor.take(first, CLOCK.sample_period_s, voltage_v, displacement_um,
                               int(Flag.TRACKING))
    return Watched(change, duration_s, tuple(raised))


def table(runs: list[Watched]) -> str:
    """Return the rows of runs as Markdown."""
    rows = ["| change after 30 s | found after | by | false alarms |", "|---|---|---|---|"]
    for run in runs:
        found = run.found if run.change else []
        after = f"{found[0].at_s - CHANGE_S:.1f} s" if found else "not found" if run.change else "-"
        by = ", ".join(one.statistic for one in found) or "-"
        name = run.change or f"none, in {run.watched_s / 60.0:g} min"
        rows.append(f"| {name} | {after} | {by} | {run.false_alarms} |")
    return "\n".join(rows) + "\n"
