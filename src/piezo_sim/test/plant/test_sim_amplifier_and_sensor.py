# SPDX-License-Identifier: BSD-3-Clause
"""Both ends of the chain: amplifier and displacement sensor."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import read_plant

AMPLIFIER = read_plant().amplifier[0]
SENSOR = read_plant().sensor[0]
SURROUNDINGS = Surroundings(sample_period_s=2.5e-5, rest_voltage_v=0.0, seed=4)
LARGEST_CHANGE_V = AMPLIFIER.slew_rate_v_per_s * SURROUNDINGS.sample_period_s


def amplified(voltage_v, rest_voltage_v=0.0):
    runner = AMPLIFIER.start(SURROUNDINGS)
    runner.rest(rest_voltage_v)
    samples = np.array(voltage_v, dtype=float)
    runner.apply(samples)
    return samples


def measured(displacement_um, **changes):
    samples = np.array(displacement_um, dtype=float)
    dataclasses.replace(SENSOR, **changes).start(SURROUNDINGS).apply(samples)
    return samples


@settings(deadline=None)  # the first example may compile
@given(arrays(float, 30, elements=st.floats(-1e6, 1e6)))
def test_amplifier_never_leaves_its_range_nor_its_slew_rate(voltage_v):
    output_v = amplified(voltage_v)
    assert np.all((output_v >= -20.0) & (output_v <= 120.0))
    assert np.all(np.abs(np.diff(output_v)) <= LARGEST_CHANGE_V * (1 + 1e-12))


def test_amplifier_clips_to_its_range():
    assert amplified(np.full(5, 500.0))[-1] == 120.0
    assert amplified(np.full(5, -500.0))[-1] == -20.0


def test_slew_rate_spreads_a_jump_over_several_samples():
    output_v = amplified([120.0] * 5, rest_voltage_v=-20.0)
    assert output_v == pytest.approx([30.0, 80.0, 120.0, 120.0, 120.0])


def test_amplifier_output_takes_the_levels_of_a_16_bit_converter():
    step_v = 140.0 / 65535
    voltage_v = np.linspace(10.0, 10.0 + 20 * step_v, 2001)
    output_v = amplified(voltage_v)
    levels = (output_v + 20.0) / step_v
    assert levels == pytest.approx(np.rint(levels), abs=1e-6)
    assert np.max(np.abs(output_v - voltage_v)) == pytest.approx(step_v / 2, rel=0.03)
    assert 20 <= np.unique(output_v).size <= 22


def test_sensor_noise_is_white_gaussian_of_9_nm():
    count = 200_000
    noise_um = measured(np.zeros(count), converter_bits=32)
    assert np.std(noise_um) == pytest.approx(0.009, rel=0.01)
    assert abs(np.mean(noise_um)) < 5 * 0.009 / np.sqrt(count)
    assert np.mean(np.abs(noise_um) < 0.009) == pytest.approx(0.6827, abs=0.006)
    for lag in (1, 2, 40):
        correlation = np.corrcoef(noise_um[lag:], noise_um[:-lag])[0, 1]
        assert abs(correlation) < 5 / np.sqrt(count)


def test_measurements_take_the_levels_of_a_16_bit_converter():
    step_um = 200.0 / 65535
    displacement_um = np.linspace(60.0, 60.0 + 20 * step_um, 2001)
    output_um = measured(displacement_um, noise_rms_um=0.0)
    levels = (output_um + 50.0) / step_um
    assert levels == pytest.approx(np.rint(levels), abs=1e-6)
    assert np.max(np.abs(output_um - displacement_um)) == pytest.approx(step_um / 2, rel=0.03)
    assert 20 <= np.unique(output_um).size <= 22


def test_measurements_saturate_at_the_ends_of_the_span():
    assert measured([-1e3, 1e3]) == pytest.approx([-50.0, 150.0])


@pytest.mark.parametrize(
    ("effect", "change"),
    [
        (AMPLIFIER, {"voltage_min_v": 120.0}),
        (AMPLIFIER, {"converter_bits": 0}),
        (AMPLIFIER, {"slew_rate_v_per_s": 0.0}),
        (SENSOR, {"noise_rms_um": -1.0}),
        (SENSOR, {"displacement_max_um": -50.0}),
        (SENSOR, {"converter_bits": 33}),
    ],
)
def test_impossible_parameters_are_refused(effect, change):
    with pytest.raises(PlantConfigError, match=f"{effect.name}: .* must"):
        dataclasses.replace(effect, **change)
