# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
import pytest

from piezo_identification.estimators.creep import slow_creep
from piezo_identification.estimators.creep.slow_creep import estimate_slow_creep
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.identification.linear_dynamics import estimate_linear_dynamics

CREEP = ((0.05, 0.04), (0.8, 0.03))
FREQUENCY_HZ = np.geomspace(0.005, 1.0, 20)
PERIOD_S = 0.05


def ways(corners):
    """Voltage that goes straight between (time, voltage) corners, sampled every `PERIOD_S`."""
    times, voltages = np.transpose(corners)
    return np.interp(np.arange(0.0, times[-1], PERIOD_S), times, voltages)


WAVEFORMS = {
    "steps": np.repeat([0.0, 60.0, 20.0, 80.0, 10.0], 800),
    "staircase": np.repeat([*range(0, 90, 10), *range(70, -1, -10)], 500).astype(float),
    "trapezoid": np.tile(ways([(0, 0), (4, 80), (60, 80), (64, 0), (120, 0)]), 3),
    "triangles": ways([(0, 0), (40, 80), (60, 20), (90, 70), (130, 5), (170, 60), (210, 0),
                       (211, 50), (300, 50)]),
}


def error_of(creep, stage):
    """Largest relative error of the response but for a common gain."""
    ratio = creep.response(FREQUENCY_HZ) / stage.creep_response(FREQUENCY_HZ)
    return np.abs(ratio / ratio[-1] - 1.0).max()


@pytest.fixture(scope="module", autouse=True)
def few_cells():
    """The loops of this stage may be followed by cells that are twice as wide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slow_creep, "CELLS", 16)
        yield


@pytest.fixture(scope="module")
def stage(foreign_stage):
    return foreign_stage(CREEP)


@pytest.mark.parametrize("waveform", [
    "steps", *(pytest.param(name, marks=pytest.mark.long)
               for name in ("trapezoid", "staircase", "triangles"))])
def test_creep_is_found_from_any_slow_voltage(waveform, stage, record):
    estimate = estimate_slow_creep(record(stage, WAVEFORMS[waveform], PERIOD_S))
    assert error_of(estimate.model, stage) < 3e-3


def test_creep_of_a_slow_triangle_is_told_from_hysteresis_by_the_loops(stage, record):
    triangle_v = ways([(0, 0), (100, 80), (200, 0)])
    loops_v = ways([(0, 0), (6, 80), (12, 0), (16, 60), (21, 10), (24, 50), (27, 20), (30, 0)])
    found = estimate_linear_dynamics(
        [record(stage, triangle_v, PERIOD_S)], [], [record(stage, loops_v, PERIOD_S)],
        ResponseOrder(len(CREEP), None, None))
    assert error_of(found.creep, stage) < 1e-2


@pytest.mark.long
def test_what_a_first_rise_leaves_is_not_taken_for_creep(independent_stage, recorded):
    """Steps of a stage never cycled, whose plays do not come back to where they began."""
    stage = independent_stage(creep_rates=(0.05, 0.8), creep_gains=(0.04, 0.03))
    voltage_v = np.repeat([0.0, 60.0, 20.0, 80.0, 0.0], 1200)
    estimate = estimate_slow_creep(recorded(
        "never cycled", voltage_v, stage.displacement_um(voltage_v, PERIOD_S), PERIOD_S, 0.002))
    zeros, gains = (0.05, 0.8), (0.04, 0.03)
    response = 1.0 + sum(gain / (1.0 + 2j * np.pi * FREQUENCY_HZ / rate)
                         for rate, gain in zip(zeros, gains, strict=True))
    ratio = estimate.model.response(FREQUENCY_HZ) / response
    assert np.abs(ratio / ratio[-1] - 1.0).max() < 3e-3
