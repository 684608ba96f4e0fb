# SPDX-License-Identifier: BSD-3-Clause
"""A linear stage, a law for it, and an engine that plays both."""

from dataclasses import replace

import control
import numpy as np

from piezo_models.feedback_law.feedback_law import DeclaredPlant, FeedbackLaw, LinearBlock
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import FeedbackLimits, VoltageLimits

TICK, RATE_HZ = 40, 40_000.0
APPROACH_TICKS = 20


class LinearStage:
    """A mode of vibration behind a gain, with noise and an offset, given ahead by whole ticks."""

    sample_rate_hz = RATE_HZ

    def __init__(self, gain_um_per_v=1.0, frequency_hz=453.0, damping=0.3, lead_ticks=0,
                 noise_um=0.009, offset_um=0.0, seed=0):
        w = 2 * np.pi * frequency_hz
        self.plant = control.c2d(
            control.ss(control.tf([w**2], [1, 2 * damping * w, w**2])), 1 / RATE_HZ)
        self.gain_um_per_v = gain_um_per_v
        self.lead_samples = lead_ticks * TICK
        self._late_v = np.zeros(self.lead_samples)
        self._state = np.zeros(2)
        self._noise_um, self._offset_um = noise_um, offset_um
        self._draws = np.random.default_rng(seed)
        self.played_v, self.displacement_um = [], []

    def exchange(self, voltage_v):
        late_v = np.r_[self._late_v, voltage_v]
        late_v, self._late_v = late_v[:len(voltage_v)], late_v[len(voltage_v):]
        displacement_um = np.empty(len(voltage_v))
        a, b, c = self.plant.A, self.gain_um_per_v * self.plant.B[:, 0], self.plant.C[0]
        for n, value_v in enumerate(late_v):
            displacement_um[n] = c @ self._state + self._offset_um
            self._state = a @ self._state + b * value_v
        displacement_um += self._noise_um * self._draws.normal(size=len(voltage_v))
        self.played_v.append(voltage_v.copy())
        self.displacement_um.append(displacement_um)
        return displacement_um


def declared(stage, gain_um_per_v=None):
    system, gain = stage.plant, gain_um_per_v or stage.gain_um_per_v
    return DeclaredPlant(LinearBlock.of(system.A, system.B, system.C, system.D),
                         gain * np.array([0.9, 1.0, 1.1]))


def integral_law(stage, rate=0.15, gain_um_per_v=None, **changes):
    """Return u = rate / gain * sum of errors beside a reference of 30 um reached in a line."""
    gain = gain_um_per_v or stage.gain_um_per_v
    once_um = stage.gain_um_per_v * planned_v()[0]
    law = FeedbackLaw(
        LinearBlock.of([1.0], [rate / gain], [1.0], [rate / gain]), np.array([0.5]), 20.0,
        once_um, np.zeros(0), declared(stage, gain), start_sample=APPROACH_TICKS * TICK)
    return replace(law, **changes)


def planned_v(ticks=100):
    """Return a feedforward: a line to 30 V, then held; and nothing that is repeated."""
    once_v = np.full(ticks * TICK, 30.0)
    once_v[:APPROACH_TICKS * TICK] = np.linspace(0.0, 30.0, APPROACH_TICKS * TICK)
    return once_v, []


def engine_of(stage, **options):
    options = {"feedback_limits": FeedbackLimits(140.0, 15.0, 3)} | options
    return StageEngine(stage, VoltageLimits(-20.0, 120.0, 2.0e6), samples_per_tick=TICK, **options)


def begin(engine, law, ticks=100, onboard=True):
    engine.commands.load_feedforward(*planned_v())
    if law is not None:
        engine.commands.load_feedback(engine.commands.checked(law))
    engine.commands.start_tracking(not onboard, ticks, "", onboard)


def finish(engine, most=4000):
    blocks = []
    while (not engine.idle or engine.holds_block) and most:
        blocks.append(engine.advance())
        most -= 1
    assert most, "the engine never came to rest"
    return [block for block in blocks if block is not None]
