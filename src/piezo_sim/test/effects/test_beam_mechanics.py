# SPDX-License-Identifier: BSD-3-Clause
"""Creep, modes and drift of the plant `beam` against analytic solutions."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from piezo_sim.effects.ambient_temperature import ThermalDrift
from piezo_sim.effects.clamped_beam import WAVE_NUMBERS, ClampedBeam, mode_shape
from piezo_sim.effects.power_law_creep import PowerLawCreep
from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import read_plant

_, CREEP, BEAM, DRIFT = read_plant("beam").stage


def crept(period_s, count):
    """Creep after a unit step at the sample instants, shape (count,)."""
    runner = CREEP.start(Surroundings(period_s, 0.0, 1))
    runner.rest(0.0)
    samples = np.ones(count)
    runner.apply(samples)
    return samples - 1.0


def power_law(time_s):
    """Creep after a unit step as the docstring states it."""
    def grown(t):
        return (1.0 + t / CREEP.onset_time_s) ** CREEP.exponent - 1.0

    return CREEP.creep_at_reference * grown(time_s) / grown(CREEP.reference_time_s)


def test_the_plant_holds_the_effects_tested_here():
    assert isinstance(CREEP, PowerLawCreep)
    assert isinstance(BEAM, ClampedBeam)
    assert isinstance(DRIFT, ThermalDrift)


@pytest.mark.parametrize("period_s", [1e-3, 0.03, 1.0])
def test_creep_follows_the_power_law_over_six_decades(period_s):
    time_s = period_s * np.arange(1, 1001)
    assert crept(period_s, 1001)[1:] == pytest.approx(power_law(time_s), rel=3e-4)


def test_each_decade_creeps_by_a_power_of_ten_more_than_the_one_before():
    creep = crept(0.1, 10_001)[[1, 10, 100, 1000, 10_000]]
    growth = np.diff(creep)[1:] / np.diff(creep)[:-1]
    # The onset still shows in the first decade.
    assert growth[1:] == pytest.approx(10.0**CREEP.exponent, rel=5e-3)
    assert np.diff(creep)[0] == pytest.approx(0.011, abs=0.001)
    assert np.diff(creep)[2] == pytest.approx(0.016, abs=0.001)


def test_creep_is_no_sum_of_a_few_exponentials():
    # Its slope against the logarithm of time would swing between them.
    creep = crept(0.1, 10_001)
    each_third = np.round(10.0 ** np.arange(0.0, 4.01, 1.0 / 3.0)).astype(int)
    slope = np.diff(creep[each_third]) / np.diff(np.log(each_third))
    smooth = np.polyval(np.polyfit(np.arange(slope.size), np.log(slope), 2), np.arange(slope.size))
    assert np.abs(np.log(slope) - smooth).max() < 0.02


def test_shapes_of_the_modes_are_clamped_orthogonal_and_of_unit_square():
    for number in WAVE_NUMBERS:
        assert math.cos(number) * math.cosh(number) == pytest.approx(1.0, abs=1e-9)
        assert [mode_shape(number, end) for end in (0.0, 1.0)] == pytest.approx([0, 0], abs=1e-9)
        assert mode_shape(number, 1e-6) == pytest.approx(0.0, abs=1e-9)
    products = [[quad(lambda x, a=a, b=b: mode_shape(a, x) * mode_shape(b, x), 0, 1)[0]
                 for a in WAVE_NUMBERS] for b in WAVE_NUMBERS]
    assert np.array(products) == pytest.approx(np.eye(3), abs=1e-6)


def frequencies_rad_per_s(beam):
    values = np.linalg.eigvals(beam.state_space().a)
    return np.sort(np.abs(values[values.imag > 0.0]))


def test_without_its_actuator_the_beam_has_the_frequencies_of_euler_and_bernoulli():
    free = dataclasses.replace(BEAM, actuator_stiffness_n_per_m=1e-3,
                               damping_ratios=(0.01, 0.02, 0.03))
    inertia_m4 = BEAM.width_m * BEAM.thickness_m**3 / 12.0
    area_m2 = BEAM.width_m * BEAM.thickness_m
    speed = math.sqrt(BEAM.elastic_modulus_pa * inertia_m4 / (BEAM.density_kg_per_m3 * area_m2))
    expected = [(number / BEAM.length_m) ** 2 * speed for number in (4.73004, 7.85320, 10.99561)]
    assert frequencies_rad_per_s(free) == pytest.approx(expected, rel=1e-4)
    values = np.linalg.eigvals(free.state_space().a)
    values = values[values.imag > 0.0]
    values = values[np.argsort(values.imag)]
    assert -values.real / np.abs(values) == pytest.approx([0.01, 0.02, 0.03], rel=1e-6)


def test_the_actuator_couples_the_modes_to_the_roots_of_the_secular_equation():
    light = dataclasses.replace(BEAM, damping_ratios=(1e-9, 1e-9, 1e-9))
    w = BEAM.frequencies_rad_per_s()
    mass_kg = BEAM.density_kg_per_m3 * BEAM.length_m * BEAM.width_m * BEAM.thickness_m
    pushed = np.array([mode_shape(number, BEAM.actuator_place) for number in WAVE_NUMBERS])
    strength = BEAM.actuator_stiffness_n_per_m / mass_kg * pushed**2

    def secular(frequency):
        return 1.0 + np.sum(strength / (w**2 - frequency**2))

    # A spring lifts each mode, but none beyond the next of the free beam.
    limits = [*w, 3.0 * w[-1]]
    roots = [brentq(secular, low * (1 + 1e-12), high * (1 - 1e-12))
             for low, high in zip(limits[:-1], limits[1:], strict=True)]
    found = frequencies_rad_per_s(light)
    assert found == pytest.approx(roots, rel=1e-9)
    assert found[0] > 1.1 * w[0]
    assert found / (2 * np.pi) == pytest.approx([604.0, 1435.0, 2814.0], abs=1.0)


def test_modal_damping_couples_the_coupled_modes():
    a = BEAM.state_space().a
    _, coupled = np.linalg.eigh(-a[3:, :3])
    damping = coupled.T @ -a[3:, 3:] @ coupled
    beside = damping - np.diag(np.diag(damping))
    assert np.abs(beside).max() > 0.005 * np.diag(damping).min()


def test_the_beam_has_unit_static_gain_and_all_modes_answer():
    system = BEAM.state_space()
    assert -system.c @ np.linalg.solve(system.a, system.b) == pytest.approx(1.0, rel=1e-12)
    peaks = frequencies_rad_per_s(BEAM)
    for peak in peaks:
        beside, on_peak = (abs(system.c @ np.linalg.solve(
            1j * w * np.eye(6) - system.a, system.b)) for w in (0.9 * peak, peak))
        assert on_peak > 1.2 * beside


def test_drift_has_the_variance_of_a_thermal_mass_behind_a_random_walk():
    period_s, count, draws = 6.0, 600, 400
    ends_um = []
    for seed in range(draws):
        runner = DRIFT.start(Surroundings(period_s, 0.0, seed))
        samples = np.zeros(count)
        runner.apply(samples)
        ends_um.append(samples[-1])
    # Integral of (1 - exp(-(t - s) / tau))^2 over the walk's steps at s.
    time_s, tau_s = period_s * count, DRIFT.time_constant_s
    share = time_s / tau_s
    integral = tau_s * (share - 2.0 * -math.expm1(-share) + 0.5 * -math.expm1(-2.0 * share))
    expected_um = DRIFT.expansion_um_per_k * DRIFT.ambient_walk_k_per_sqrt_s * math.sqrt(integral)
    assert np.std(ends_um) == pytest.approx(expected_um, rel=4.0 / math.sqrt(2 * draws))
    assert abs(np.mean(ends_um)) < 4.0 * expected_um / math.sqrt(draws)
    assert expected_um == pytest.approx(0.13, abs=0.03)


@pytest.mark.parametrize(("effect", "change"), [
    (CREEP, {"exponent": 1.0}), (CREEP, {"onset_time_s": 0.0}), (CREEP, {"reference_time_s": 0.0}),
    (CREEP, {"memory_s": 1e-3}), (BEAM, {"length_m": 0.0}), (BEAM, {"damping_ratios": (0.1, 0.1)}),
    (BEAM, {"damping_ratios": (0.1, 0.1, 0.0)}), (BEAM, {"actuator_place": 0.0}),
    (BEAM, {"sensor_place": 1.0}), (BEAM, {"actuator_stiffness_n_per_m": 0.0}),
])
def test_impossible_parameters_are_refused(effect, change):
    with pytest.raises(PlantConfigError, match=f"{effect.name}: .* must"):
        dataclasses.replace(effect, **change)
