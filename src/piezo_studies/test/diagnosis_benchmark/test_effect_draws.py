# SPDX-License-Identifier: BSD-3-Clause
"""Effects drawn at random: as strong as wanted, the same for the same seed."""

import dataclasses

import numpy as np
import pytest

from piezo_sim.effects.transport_delay import TransportDelay
from piezo_sim.plant.plant import Plant
from piezo_sim.plant.plant_effect import Surroundings
from piezo_sim.plant.plant_file import read_plant
from piezo_studies.diagnosis_benchmark.effect_draws import (
    CAUSES,
    CAUSES_OUTSIDE,
    DrawError,
    add_effect,
    draw_effect,
    response_um,
)

SURROUNDINGS = Surroundings(sample_period_s=2.5e-5, rest_voltage_v=0.0, seed=2)
NOISE_UM = 0.009


def sweep_and_steps():
    random = np.random.default_rng(3)
    sine_v = 50.0 - 45.0 * np.cos(2 * np.pi * 8.0 * 2.5e-5 * np.arange(15_000))
    return np.concatenate([sine_v, np.repeat(random.uniform(0.0, 100.0, 25), 600)])


VOLTAGE_V = sweep_and_steps()


@pytest.mark.parametrize("cause", [*CAUSES, *CAUSES_OUTSIDE])
def test_a_drawn_effect_adds_the_multiple_of_the_noise_that_was_wanted(cause):
    drawn = draw_effect(cause, read_plant(), VOLTAGE_V, SURROUNDINGS, noise_multiple=3.0, seed=8)
    measured_um, _ = Plant(drawn.plant, SURROUNDINGS).respond(VOLTAGE_V)
    nominal_um, _ = Plant(read_plant(), SURROUNDINGS).respond(VOLTAGE_V)
    # The same seed gives both the same noise; what is left are the steps of the converter.
    assert np.std(measured_um - nominal_um) == pytest.approx(3.0 * NOISE_UM, rel=0.03)
    assert drawn.contribution_rms_um == pytest.approx(3.0 * NOISE_UM, rel=0.01)


def test_the_list_is_that_of_the_diagnosis():
    assert list(CAUSES) == [
        "creep",
        "thermal_drift",
        "vibration_mode",
        "delay",
        "sensor_lag",
        "sensor_nonlinearity",
        "periodic_disturbance",
        "slew_limit",
        "voltage_clipping",
        "rate_dependent_hysteresis",
        "stiffening",
        "backlash",
        "outliers",
    ]
    assert CAUSES.keys().isdisjoint(CAUSES_OUTSIDE)


def test_seeds_draw_other_shapes_and_repeat_themselves():
    def shape(seed):
        drawn = draw_effect("vibration_mode", read_plant(), VOLTAGE_V, SURROUNDINGS, 5.0, seed)
        return drawn.effect

    assert shape(1) == shape(1)
    assert shape(1).frequency_rad_per_s != shape(2).frequency_rad_per_s


def test_a_second_effect_is_drawn_on_top_of_the_first():
    first = draw_effect("creep", read_plant(), VOLTAGE_V, SURROUNDINGS, 4.0, seed=1)
    second = draw_effect("backlash", first.plant, VOLTAGE_V, SURROUNDINGS, 6.0, seed=1)
    both_um, first_um, none_um = (
        response_um(plant, VOLTAGE_V, SURROUNDINGS)
        for plant in (second.plant, first.plant, read_plant())
    )
    assert np.std(first_um - none_um) == pytest.approx(4.0 * NOISE_UM, rel=0.01)
    assert np.std(both_um - first_um) == pytest.approx(6.0 * NOISE_UM, rel=0.01)


def test_a_slow_record_shows_what_is_between_its_samples():
    slow = dataclasses.replace(SURROUNDINGS, sample_period_s=1e-3)
    levels_v = np.repeat([0.0, 40.0, 10.0, 80.0], 50)
    late_s = 3e-4
    plant, late = read_plant(), add_effect(read_plant(), TransportDelay(late_s))
    fine = dataclasses.replace(slow, sample_period_s=1e-4)
    fine_um = response_um(plant, np.repeat(levels_v, 10), fine)
    expected_um = np.concatenate([np.full(3, fine_um[0]), fine_um[:-3]])[::10]
    np.testing.assert_allclose(response_um(late, levels_v, slow, 10), expected_um, atol=1e-6)
    drawn = draw_effect("delay", plant, levels_v, slow, 5.0, seed=1, clock_samples=10)
    assert drawn.contribution_rms_um == pytest.approx(5.0 * NOISE_UM, rel=0.01)


@pytest.mark.parametrize("cause", ["delay", "slew_limit", "voltage_clipping", "backlash"])
def test_a_record_at_rest_cannot_show_what_needs_motion(cause):
    with pytest.raises(DrawError, match=f"{cause}: .*choose another record"):
        draw_effect(cause, read_plant(), np.zeros(400), SURROUNDINGS, 3.0, seed=1)
