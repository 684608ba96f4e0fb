# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of backends with a waveform memory share."""

from pathlib import Path

import numpy as np

from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.engine.blocks import FLAG_PLAYING
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import VoltageLimits

CONFIG = Path(__file__).parents[1] / "config"
RATE_HZ = 2000.0
LONGEST = 1000
WAVE_V = 40.0 + 30.0 * np.sin(2.0 * np.pi * np.arange(500) / 100.0)


def settings(**changes):
    return BackendSettings(**{
        "file": "", "sample_rate_hz": RATE_HZ, "samples_per_tick": 10, "minimum_voltage_v": -20.0,
        "maximum_voltage_v": 100.0, "rest_voltage_v": 0.0, "ramp_rate_v_per_s": 2000.0,
        "exchange_timeout_s": 60.0, **changes})


def engine_of(backend):
    return StageEngine(backend, VoltageLimits(-20.0, 100.0, 2.0e6), samples_per_tick=10,
                       longest_stretch_samples=10)


def played(engine, voltage_v):
    """Play a waveform; return the voltage and the displacement that were published with it."""
    engine.commands.play(voltage_v, 1.0 / RATE_HZ)
    blocks = []
    while not engine.at_rest:
        block = engine.advance()
        if block is not None and block.flags & FLAG_PLAYING:
            blocks.append(block)
    return tuple(np.concatenate([getattr(block, name) for block in blocks])
                 for name in ("voltage_v", "displacement_um"))
