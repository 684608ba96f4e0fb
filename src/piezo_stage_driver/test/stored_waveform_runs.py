# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of backends with a waveform memory share."""

from pathlib import Path

import numpy as np
import yaml

from piezo_stage_driver.backends.pi_gcs_stage import PiAxis
from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.engine.blocks import FLAG_PLAYING
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import SensorRange
from piezo_stage_driver.safety.limits import AxesLimits, VoltageLimits

CONFIG = Path(__file__).parents[1] / "config"
RATE_HZ = 2000.0
LONGEST = 1000
WAVE_V = 40.0 + 30.0 * np.sin(2.0 * np.pi * np.arange(500) / 100.0)
BOTH_V = np.column_stack([WAVE_V, 5.0 + 0.5 * WAVE_V[::-1]])
REST_V, RAMP_V_PER_S = np.array([0.0, 5.0]), np.array([2000.0, 500.0])


def of_y(axis):
    """Return the settings of an axis, which are those of the stage for x."""
    return {"rest_voltage_v": REST_V[1], "ramp_rate_v_per_s": RAMP_V_PER_S[1]} if (
        axis == "y") else {}


def settings(**changes):
    return BackendSettings(**{
        "file": "", "sample_rate_hz": RATE_HZ, "samples_per_tick": 10, "minimum_voltage_v": -20.0,
        "maximum_voltage_v": 100.0, "rest_voltage_v": 0.0, "ramp_rate_v_per_s": 2000.0,
        "exchange_timeout_s": 60.0, **changes})


def pi_axes(**changes_of_y):
    """Return the settings of a controller that drives x by its axis 1 and y by its axis 2."""
    shared = yaml.safe_load((CONFIG / "pi_gcs_settings.yaml").read_text())
    x = {name: shared.pop(name) for name in PiAxis.model_fields}
    y = x | {"axis": "2", "output_channel": 2, "wave_generator": 2, "wave_table": 2,
             "control_per_v": 2.0, "displacement_um_per_unit": 4.0}
    return {**shared, "axes": {"x": x, "y": {**y, **changes_of_y}}}


def engine_of(backend):
    return StageEngine(backend, VoltageLimits(-20.0, 100.0, 2.0e6), samples_per_tick=10,
                       longest_stretch_samples=10)


def axes_engine_of(backend, latch=None):
    """Return an engine of the axes x and y, each with its own range, rest and ramp."""
    return StageEngine(
        backend, AxesLimits({"x": VoltageLimits(-20.0, 100.0, 2.0e6),
                             "y": VoltageLimits(0.0, 50.0, 2.0e6)}),
        REST_V, RAMP_V_PER_S, samples_per_tick=10, longest_stretch_samples=10, latch=latch,
        sensor_guards={axis: (SensorRange(-30.0, 110.0),) for axis in ("x", "y")})


def played(engine, voltage_v):
    """Play a waveform; return the voltage and the displacement that were published with it."""
    engine.commands.play(np.ravel(voltage_v), 1.0 / RATE_HZ, axes=engine.axes)
    blocks = []
    while not engine.at_rest:
        block = engine.advance()
        if block is not None and block.flags & FLAG_PLAYING:
            blocks.append(block)
    return tuple(np.concatenate([getattr(block, name) for block in blocks])
                 for name in ("voltage_v", "displacement_um"))
