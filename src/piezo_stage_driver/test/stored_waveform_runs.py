# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of backends with a waveform memory share."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from commands_by_name import command

from piezo_stage_driver.backends.pi_gcs_stage import PiAxis
from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.engine.blocks import FLAG_PLAYING
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import SensorRange
from piezo_stage_driver.safety.limits import AxesLimits, VoltageLimits
from piezo_stage_driver.safety.supervisor import StageSupervisor

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


def engine_of(backend, latch=None):
    return StageEngine(backend, VoltageLimits(-20.0, 100.0, 2.0e6), samples_per_tick=10,
                       longest_stretch_samples=10, latch=latch)


def axes_engine_of(backend, latch=None):
    """Return an engine of the axes x and y, each with its own range, rest and ramp."""
    return StageEngine(
        backend, AxesLimits({"x": VoltageLimits(-20.0, 100.0, 2.0e6),
                             "y": VoltageLimits(0.0, 50.0, 2.0e6)}),
        REST_V, RAMP_V_PER_S, samples_per_tick=10, longest_stretch_samples=10, latch=latch,
        sensor_guards={axis: (SensorRange(-30.0, 110.0),) for axis in ("x", "y")})


def supervised(stage, make_engine, voltage_v):
    """Return a supervisor whose stage is to play a waveform, and the ends of that goal."""
    supervisor = StageSupervisor(stage, make_engine, closing_ticks=stage.lead_samples // 10 + 1)
    supervisor.activate()
    ends = []
    supervisor.submit(command(
        "play", np.ravel(voltage_v), 1.0 / RATE_HZ, 1, False, "", stage.axes,
        on_done=lambda *answer: None,
        goal=SimpleNamespace(cancelled=False, attend=lambda engine: None,
                             end=lambda *end: ends.append(end))))
    return supervisor, ends


def assert_refused(module, document, path, sentence):
    """Create a backend from impossible settings, which is refused in one sentence."""
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(ValueError, match=sentence) as failure:
        module.create(settings(file=str(path)))
    assert str(failure.value).startswith(str(path)) and "\n" not in str(failure.value)


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
