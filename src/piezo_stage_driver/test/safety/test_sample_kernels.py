# SPDX-License-Identifier: BSD-3-Clause
"""What every tick calls computes what NumPy does, and is compiled before the first tick."""

import subprocess
import sys

import numpy as np
import pytest

from piezo_stage_driver.safety.sample_kernels import extremes, fourth_difference, tick_means

PROGRAM = """
import numpy as np
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety import sample_kernels as kernels
from piezo_stage_driver.safety.guards import SensorNoise, SensorRange, SensorResponse
from piezo_stage_driver.safety.limits import AxesLimits, VoltageLimits


class Backend:
    sample_rate_hz = 40_000.0

    def exchange(self, voltage_v):
        return np.zeros(voltage_v.shape)


class Axes(Backend):
    axes = "x", "y"


def compiled():
    return [len(kernel.signatures) for kernel in (
        kernels.hold_within, kernels.extremes, kernels.tick_means, kernels.fourth_difference)]


kernels.compile_kernels()
before = compiled()
limits = VoltageLimits(0.0, 100.0, 1e6)
guards = (SensorRange(-1.0, 1.0), SensorResponse(), SensorNoise(1.0))
StageEngine(Backend(), limits, sensor_guards=guards).advance()
StageEngine(Axes(), AxesLimits({"x": limits, "y": limits}), np.zeros(2), np.full(2, 2000.0),
            sensor_guards={"x": guards, "y": guards}).advance()
print(before, compiled())
"""


def test_first_tick_compiles_nothing():
    # In a process of its own: what other tests have compiled stays compiled in this one.
    told = subprocess.run([sys.executable, "-c", PROGRAM], check=True, text=True,
                          capture_output=True).stdout
    assert told == "[1, 1, 1, 1] [1, 1, 1, 1]\n"


@pytest.mark.parametrize("count", [5, 6, 40])
def test_kernels_compute_what_numpy_does(count):
    values = np.random.default_rng(count).normal(size=count)
    assert extremes(values) == (values.min(), values.max())
    assert fourth_difference(values) == pytest.approx(np.abs(np.diff(values, 4)).mean())
    ticks = np.random.default_rng(0).normal(size=(3, count))
    np.testing.assert_allclose(tick_means(ticks.ravel(), count), ticks.mean(axis=1))


def test_value_that_is_no_number_is_in_both_extremes():
    assert np.isnan(extremes(np.array([1.0, np.nan, 2.0]))).all()
