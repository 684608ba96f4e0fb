# SPDX-License-Identifier: BSD-3-Clause
"""Undeclared effects against analytic solutions and brute force."""

import dataclasses
import math
from importlib import resources

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import gammainc

from piezo_sim.effects.ambient_temperature import ThermalDrift
from piezo_sim.effects.current_limit import CurrentLimit
from piezo_sim.effects.depolarisation import Depolarisation
from piezo_sim.effects.distributed_lag import DistributedLag
from piezo_sim.effects.guide_spring import GuideSpring
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.effects.intermittent_contact import IntermittentContact
from piezo_sim.effects.loaded_mode import LoadedMode
from piezo_sim.effects.logarithmic_creep import LogarithmicCreep
from piezo_sim.effects.mains_hum import MainsHum
from piezo_sim.effects.parallel_mode import ParallelMode
from piezo_sim.effects.placement import add_effect
from piezo_sim.effects.self_heating import SelfHeating
from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_sim.effects.soft_saturation import SoftSaturation
from piezo_sim.effects.spikes import Spikes
from piezo_sim.effects.switched_heat import SwitchedHeat
from piezo_sim.effects.switching_delay import SwitchingDelay
from piezo_sim.effects.transducer_curve import TransducerCurve
from piezo_sim.effects.transport_delay import TransportDelay
from piezo_sim.plant.linear_effects import ElectricLag, LinearRunner, VibrationMode
from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import EFFECTS, parse_plant, read_plant

PERIOD_S = 2.5e-5
SURROUNDINGS = Surroundings(sample_period_s=PERIOD_S, rest_voltage_v=0.0, seed=4)

EXAMPLES = [
    LogarithmicCreep(0.01, 0.1, 1000.0),
    ThermalDrift(0.1, 0.5, 2.0, 0.05),
    ParallelMode(2 * np.pi * 1400.0, 0.01, 0.01, 2),
    TransportDelay(6.1e-5),
    DistributedLag(3e-4, 5),
    TransducerCurve(40.0, 200.0),
    MainsHum(50.0, (0.1, 0.02, 0.03), 0.1),
    CurrentLimit(0.08, 0.1, 4e-6, 0.002),
    SoftSaturation(-15.0, 90.0, 2.0),
    SwitchingDelay(0.3, 500.0, 1e-3),
    HardeningSpring(5.0, 200.0),
    SoftBacklash(0.1),
    Spikes(300.0, 1.0, 0.5),
    SelfHeating(0.01, 0.05, -1e-3),
    IntermittentContact(0.02, 0.0, 0.01, 0.01),
    Depolarisation(0.05, 500.0),
    LoadedMode(4909.0, 0.081992, 0.2, 0.0, 0.05),
    SwitchedHeat(1.0, 0.5, 0.05),
    GuideSpring(4909.0, 0.08, 5.0, 200.0),
]
every_effect = pytest.mark.parametrize("effect", EXAMPLES, ids=lambda effect: effect.name)
unhurried = settings(deadline=None)  # the first example may compile


def played(effect, levels, rest=0.0, surroundings=SURROUNDINGS):
    runner = effect.start(surroundings)
    runner.rest(rest)
    samples = np.array(levels, dtype=float)
    runner.apply(samples)
    return samples


def test_every_undeclared_effect_has_an_example():
    declared = {effect.name for effect in read_plant().stage + read_plant().amplifier}
    declared |= {effect.name for effect in read_plant().sensor}
    assert {effect.name for effect in EXAMPLES} == EFFECTS.keys() - declared


@every_effect
def test_calls_of_any_size_give_the_same_samples_to_the_bit(effect, wandering_voltage_v, exchanged):
    plant, voltage_v = add_effect(read_plant(), effect), wandering_voltage_v[:6000]
    whole = exchanged(voltage_v, voltage_v.size, plant)
    without = exchanged(voltage_v, voltage_v.size)
    assert np.std(whole[0] - without[0]) > 0.002
    for size, count in ((1, 500), (40, 6000), (4097, 6000)):
        parts = exchanged(voltage_v[:count], size, plant)
        assert all(np.array_equal(a[:count], b) for a, b in zip(whole, parts, strict=True))


@every_effect
def test_effects_of_the_sensor_leave_the_true_displacement(effect, wandering_voltage_v, exchanged):
    plant, voltage_v = add_effect(read_plant(), effect), wandering_voltage_v[:3000]
    _, true_um = exchanged(voltage_v, voltage_v.size, plant)
    _, nominal_um = exchanged(voltage_v, voltage_v.size)
    assert np.array_equal(true_um, nominal_um) == (effect in plant.sensor)


@every_effect
def test_a_voltage_acts_only_after_its_own_sample(effect, exchanged):
    plant = add_effect(read_plant(), effect)
    voltage_v = np.zeros(100)
    voltage_v[50:] = 40.0
    moved_um = exchanged(voltage_v, 100, plant)[1]
    rest_um = exchanged(np.zeros(100), 100, plant)[1]
    assert np.array_equal(moved_um[:51], rest_um[:51])
    assert moved_um[80] > rest_um[80]


@every_effect
def test_a_plant_file_may_hold_the_effect(effect):
    plant = add_effect(read_plant(), effect)

    def entry(part):
        values = {
            field.name: {
                "value": list(value) if isinstance(value, tuple) else value,
                "unit": field.metadata["unit"],
                "source": "test",
            }
            for field in dataclasses.fields(part)
            for value in [getattr(part, field.name)]
        }
        return {"effect": part.name} | values

    sections = {
        field.name: [entry(part) for part in getattr(plant, field.name)]
        for field in dataclasses.fields(plant)
    }
    assert parse_plant(yaml.safe_dump(sections)) == plant


@pytest.mark.parametrize(
    "effect",
    [EXAMPLES[1], EXAMPLES[6], EXAMPLES[12], EXAMPLES[14]],
    ids=lambda effect: effect.name,
)
def test_what_is_random_follows_the_seed(effect):
    level = np.full(20_000, 10.0)
    one = played(effect, level)
    assert np.array_equal(one, played(effect, level))
    other = dataclasses.replace(SURROUNDINGS, seed=5)
    assert not np.array_equal(one, played(effect, level, surroundings=other))


def test_creep_follows_the_logarithm_of_time():
    creep = LogarithmicCreep(gain_per_efold=0.01, onset_time_s=0.1, memory_s=1e5)
    system = creep.state_space()
    time_s = np.geomspace(1e-3, 1e3, 50)
    rates = -np.diag(system.a)
    creeping = system.d + system.c @ -np.expm1(-np.outer(rates, time_s))
    assert creeping == pytest.approx(1.0 + 0.01 * np.log1p(time_s / 0.1), abs=1e-4)


def test_creep_relaxes_within_the_memory():
    lag = ElectricLag(1e-4)
    runner = LinearRunner([LogarithmicCreep(0.01, 0.1, 10.0), lag], sample_period_s=0.01)
    runner.rest(0.0)
    samples = np.full(20_000, 1.0)
    runner.apply(samples)
    assert samples[1001] == pytest.approx(1.0 + 0.01 * math.log1p(100.0), abs=0.01)
    assert samples[-1] == pytest.approx(runner.rest(1.0), abs=1e-6)


def test_parallel_mode_adds_its_residue_to_the_response():
    lag, first = ElectricLag(4.9e-4), VibrationMode(2846.0, 0.685)
    second = VibrationMode(4909.0, 0.082)
    mode = ParallelMode(8796.0, 0.01, 0.02, beside=2)
    runner = LinearRunner([lag, first, second, mode], PERIOD_S)
    impulse = np.zeros(40_000)
    impulse[0] = 1.0
    runner.apply(impulse)
    frequency_hz = np.array([0.0, 300.0, 1390.0, 1400.0, 1500.0])
    s = 2j * np.pi * frequency_hz

    def low_pass(effect):
        w = effect.frequency_rad_per_s
        return w**2 / (s**2 + 2 * effect.damping_ratio * w * s + w**2)

    hold = np.exp(-s * PERIOD_S / 2) * np.sinc(frequency_hz * PERIOD_S)
    others = low_pass(first) * low_pass(second)
    expected = hold / (1 + 4.9e-4 * s) * (0.98 * others + 0.02 * low_pass(mode))
    n = np.arange(impulse.size)
    response = np.exp(-np.outer(s, n) * PERIOD_S) @ impulse
    # Sampling folds what little is left above 20 kHz.
    assert response == pytest.approx(expected, abs=2e-5)


def test_parallel_mode_needs_effects_to_lie_beside():
    with pytest.raises(PlantConfigError, match="parallel_mode: .*parallel to 2 .* only 1 lie"):
        LinearRunner([ElectricLag(1e-3), ParallelMode(8796.0, 0.01, 0.02, beside=2)], PERIOD_S)


def test_drift_without_a_walk_approaches_the_ambient_exponentially():
    drift_um = played(ThermalDrift(0.2, 3.0, 0.0, 0.1), np.full(40_000, 7.0))
    time_s = PERIOD_S * np.arange(drift_um.size)
    assert drift_um == pytest.approx(7.0 + 0.6 * -np.expm1(-time_s / 0.1), abs=1e-9)


def test_drift_spreads_like_a_random_walk_behind_a_thermal_mass():
    walk, time_constant_s, count = 2.0, 0.02, 2000
    drift = ThermalDrift(1.0, 0.0, walk, time_constant_s)
    last = [
        played(drift, np.zeros(count), surroundings=dataclasses.replace(SURROUNDINGS, seed=k))[-1]
        for k in range(800)
    ]
    # Variance of int (1 - exp(-(t - s) / tau)) dW(s)
    t = count * PERIOD_S
    decay = math.exp(-t / time_constant_s)
    variance = t - 2 * time_constant_s * (1 - decay) + time_constant_s / 2 * (1 - decay**2)
    assert np.std(last) == pytest.approx(walk * math.sqrt(variance), rel=0.1)


@pytest.mark.parametrize("delay_samples", [0.0, 0.3, 1.0, 2.44, 57.7])
def test_delay_shifts_a_smooth_signal_by_any_time(delay_samples):
    time_s = PERIOD_S * np.arange(4000)

    def signal(t):
        return 20.0 * np.sin(2 * np.pi * 300.0 * t)

    delay_s = delay_samples * PERIOD_S
    delayed = played(TransportDelay(delay_s), signal(time_s))
    assert delayed[100:] == pytest.approx(signal(time_s - delay_s)[100:], abs=2e-4)
    assert played(TransportDelay(delay_s), np.full(9, 3.0), rest=3.0) == pytest.approx(3.0)


def test_distributed_lag_gives_the_response_of_its_sections():
    lag = DistributedLag(lag_s=5e-4, sections=5)
    time_s = PERIOD_S * np.arange(1, 8001)
    ramp = played(lag, 100.0 * time_s)
    # A ramp through an Erlang distributed lag: the integral of its distribution function.
    x = time_s / 1e-4
    expected = 100.0 * (time_s * gammainc(5, x) - 5e-4 * gammainc(6, x))
    assert ramp == pytest.approx(expected, abs=1e-9)
    w = 2 * np.pi * 200.0
    sine = played(lag, np.sin(w * time_s))[-200:]
    gain = (1 + 1j * w * 1e-4) ** -5
    assert sine == pytest.approx(np.imag(gain * np.exp(1j * w * time_s[-200:])), abs=2e-4)


def test_transducer_is_exact_at_its_centre_and_bends_like_an_arctangent():
    curve = TransducerCurve(centre_um=40.0, reach_um=200.0)
    displacement_um = np.linspace(-20.0, 110.0, 500)
    bent = played(curve, displacement_um)
    assert bent == pytest.approx(40.0 + 200.0 * np.arctan((displacement_um - 40.0) / 200.0))
    near = np.abs(displacement_um - 40.0) < 20.0
    cubic_um = -((displacement_um - 40.0) ** 3) / (3 * 200.0**2)
    assert (bent - displacement_um)[near] == pytest.approx(cubic_um[near], abs=1e-3)


def test_hum_is_a_line_at_each_harmonic_with_its_amplitude():
    hum = played(MainsHum(50.0, (0.3, 0.0, 0.1), 0.0), np.zeros(40_000))
    amplitudes = np.abs(np.fft.rfft(hum)) / (hum.size / 2)
    assert amplitudes[[50, 100, 150]] == pytest.approx([0.3, 0.0, 0.1], abs=1e-9)


def test_the_phase_of_the_hum_wanders_with_the_root_of_time():
    walk, count = 2.0, 8000
    ends = []
    for seed in range(300):
        surroundings = dataclasses.replace(SURROUNDINGS, seed=seed)
        hum = played(MainsHum(50.0, (1.0,), walk), np.zeros(count), surroundings=surroundings)
        steady = played(MainsHum(50.0, (1.0,), 0.0), np.zeros(count), surroundings=surroundings)
        # Whole periods: in phase at the start; at the end sin(phase + walked).
        assert hum[0] == steady[0]
        ends.append(hum[-1] * steady[-1])
    # E[sin(a) sin(a + g)] = exp(-var / 2) / 2 for a uniform phase a.
    expected = 0.5 * math.exp(-(walk**2) * count * PERIOD_S / 2)
    assert np.mean(ends) == pytest.approx(expected, abs=0.1)


def test_limited_current_charges_the_capacitance_as_fine_steps_do():
    limit = CurrentLimit(0.05, 0.08, 2e-6, 0.0)
    voltage_v = np.repeat([0.0, 30.0, 31.0, 5.0, 5.3], 60)
    fine, present, expected = 500, 0.0, []
    step_s = PERIOD_S / fine
    for command in voltage_v:
        within = []
        for _ in range(fine):
            change = min(max(command - present, -0.08 / 2e-6 * step_s), 0.05 / 2e-6 * step_s)
            within.append(present + change / 2)
            present += change
        expected.append(np.mean(within))
    assert played(limit, voltage_v) == pytest.approx(expected, abs=2e-3)


def test_limited_current_charges_a_larger_capacitance_more_slowly():
    growing = CurrentLimit(0.05, 0.05, 2e-6, 0.01)
    rise_v = np.diff(played(growing, np.full(200, 100.0)))[1:100]
    assert rise_v[0] == pytest.approx(0.05 / 2e-6 * PERIOD_S, rel=0.02)
    assert np.all(np.diff(rise_v) < 0.0)
    assert played(growing, np.full(2000, 100.0))[-1] == 100.0


def test_saturation_bends_from_the_identity_to_its_limits():
    voltage_v = np.linspace(-200.0, 300.0, 400)
    bent = played(SoftSaturation(-15.0, 90.0, 2.0), voltage_v)
    inside = (voltage_v > 20.0) & (voltage_v < 55.0)
    assert bent[inside] == pytest.approx(voltage_v[inside], abs=1e-6)
    assert bent[[0, -1]] == pytest.approx([-15.0, 90.0], abs=1e-9)
    assert np.all(np.diff(bent) > -1e-12)
    # At the limit itself a knee is missing ln 2.
    assert played(SoftSaturation(-15.0, 90.0, 2.0), [90.0])[0] == pytest.approx(
        90.0 - 2.0 * math.log(2.0)
    )


def test_shifted_thresholds_are_relays_that_switch_later():
    delay = SwitchingDelay(
        threshold_shift_v=2.0, reference_speed_v_per_s=100.0, averaging_time_s=1e-9
    )
    speed_v_per_s = 1000.0
    shift_v = 2.0 * math.asinh(speed_v_per_s / 100.0)
    rise_v = speed_v_per_s * PERIOD_S * np.arange(4000)
    voltage_v = np.concatenate([rise_v, rise_v[::-1]])
    seen_v = played(delay, voltage_v)
    for alpha_v, beta_v in [(30.0, 10.0), (50.0, 49.0), (70.0, 20.0)]:
        on = rise_v[np.argmax(seen_v[:4000] >= alpha_v)]
        off = rise_v[::-1][np.argmax(seen_v[4000:] <= beta_v)]
        assert on == pytest.approx(alpha_v + shift_v, abs=0.06)
        assert off == pytest.approx(beta_v - shift_v, abs=0.06)


def test_thresholds_recover_when_the_voltage_stops():
    seen_v = played(SwitchingDelay(1.0, 100.0, 1e-3), np.full(4000, 20.0))
    speed = 20.0 / PERIOD_S * -math.expm1(-PERIOD_S / 1e-3)
    time_s = PERIOD_S * np.arange(4000)
    expected = 20.0 - np.arcsinh(speed * np.exp(-time_s / 1e-3) / 100.0)
    assert seen_v == pytest.approx(expected, rel=1e-9)


def test_spring_balances_the_cubic_force():
    spring = HardeningSpring(relaxed_um=5.0, hardening_length_um=80.0)
    free_um = np.linspace(-30.0, 120.0, 40)
    expected = [
        5.0 + brentq(lambda e, f=f: e + e**3 / 80.0**2 - (f - 5.0), -200.0, 200.0, xtol=1e-12)
        for f in free_um
    ]
    assert played(spring, free_um) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("period_s", "within"), [(2.5e-5, 2e-3), (4e-4, 5e-2)])
def test_a_guide_swings_by_duffings_equation(period_s, within):
    """Against an integrator of the whole equation; samples are straight between each other."""
    w, damping_ratio, relaxed_um, length_um = 2000.0, 0.05, 5.0, 40.0
    spring = GuideSpring(w, damping_ratio, relaxed_um, length_um)
    time_s = period_s * np.arange(round(0.02 / period_s))

    def drive_um(t):
        return 30.0 * np.sin(700.0 * t)

    def speeds(t, state, cube):
        y, v = state
        e = y - relaxed_um
        return v, w * w * (drive_um(t) - relaxed_um - e - cube * e**3) - 2 * damping_ratio * w * v

    def solved(cube, first_um):
        return solve_ivp(speeds, (0.0, time_s[-1]), (first_um, 0.0), t_eval=time_s, args=(cube,),
                         rtol=1e-10, atol=1e-10).y[0]

    runner = spring.start(dataclasses.replace(SURROUNDINGS, sample_period_s=period_s))
    first_um = runner.rest(0.0)
    samples = solved(0.0, 0.0)[1:]
    linear_um = samples.copy()
    runner.apply(samples)
    expected = solved(1.0 / length_um**2, first_um)[1:]
    assert np.std(samples - expected) < within * np.std(linear_um - expected)


@settings(unhurried, max_examples=15)  # each takes thousands of steps
@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=8),
    st.floats(0.01, 3.0),
)
def test_backlash_follows_its_differential_equation(moves_um, gap_um):
    drive_um = np.cumsum(moves_um)
    trail, expected = gap_um, []
    for move in moves_um:
        step = move / 4000
        for _ in range(4000):
            # Heun's rule; contact only pushes against the side it has.
            def slope(e, step=step):
                return 1.0 - (e / gap_um) ** 2 if e * step > 0.0 else 1.0

            first = slope(trail)
            trail += step * (first + slope(trail + step * first)) / 2
        expected.append(trail)
    assert drive_um - played(SoftBacklash(gap_um), drive_um) == pytest.approx(expected, abs=0.01)


@unhurried
@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=8), st.integers(2, 50))
def test_backlash_does_not_count_steps(moves_um, parts):
    coarse_um = np.cumsum(moves_um)
    fine_um = np.interp(
        np.arange(parts * coarse_um.size + 1) / parts,
        np.arange(coarse_um.size + 1),
        np.concatenate([[0.0], coarse_um]),
    )
    backlash = SoftBacklash(0.7)
    assert played(backlash, fine_um)[parts::parts] == pytest.approx(
        played(backlash, coarse_um), abs=1e-9
    )


def test_long_travel_leaves_backlash_at_half_the_gap_on_either_side():
    driven_um = played(SoftBacklash(0.2), [10.0, 0.0, 0.1, 10.0])
    assert driven_um[[0, 1, 3]] == pytest.approx([9.8, 0.2, 9.8])
    assert driven_um[2] == driven_um[1]


def test_spikes_come_at_their_rate_with_their_heights():
    count = 400_000
    spikes_um = played(Spikes(200.0, 2.0, 0.5), np.zeros(count))
    heights = spikes_um[spikes_um != 0.0]
    expected = 200.0 * count * PERIOD_S
    assert heights.size == pytest.approx(expected, abs=5 * math.sqrt(expected))
    assert np.median(np.abs(heights)) == pytest.approx(2.0, rel=0.1)
    assert np.std(np.log(np.abs(heights))) == pytest.approx(0.5, rel=0.1)
    assert np.mean(heights > 0.0) == pytest.approx(0.5, abs=0.06)


def test_self_heating_reaches_the_balance_of_losses_and_cooling():
    effect = SelfHeating(heating_k_per_um=0.02, cooling_time_constant_s=0.1, gain_per_k=-1e-3)
    time_s = PERIOD_S * np.arange(60_000)
    displacement_um = 10.0 * (1 - np.cos(2 * np.pi * 100.0 * time_s))
    speed_um_per_s = 4 * 10.0 * 100.0
    warm_k = 0.02 * speed_um_per_s * 0.1
    top = -200  # half a period before the end
    gain = played(effect, displacement_um)[top] / displacement_um[top]
    assert gain == pytest.approx(1.0 - 1e-3 * warm_k, abs=1e-3 * warm_k * 0.05)
    cooled = np.concatenate([displacement_um, np.full(60_000, 20.0)])
    assert played(effect, cooled)[-1] == pytest.approx(20.0, abs=1e-4)


def test_a_joint_is_loose_for_its_share_of_the_time():
    contact = IntermittentContact(0.1, 2.0, mean_tight_time_s=0.03, mean_loose_time_s=0.01)
    passed = played(contact, np.full(1_600_000, 12.0))
    assert set(np.unique(passed)) == {12.0, 11.0}
    assert passed[0] == 12.0
    assert np.mean(passed < 12.0) == pytest.approx(0.25, abs=0.03)
    changes = np.count_nonzero(np.diff(passed))
    assert changes == pytest.approx(2 * 40.0 / 0.04, rel=0.1)


def test_gain_falls_with_travel_and_not_with_time():
    effect = Depolarisation(lost_gain=0.1, travel_um=50.0)
    still = played(effect, np.full(1000, 10.0), rest=10.0)
    assert np.all(still == 10.0)
    moved = played(effect, np.concatenate([np.tile([0.0, 10.0], 5), np.full(9, 10.0)]))
    # 10 um at each of nine moves
    assert moved[-1] == pytest.approx(10.0 * (1 - 0.1 * (1 - math.exp(-90.0 / 50.0))))


def test_plant_of_the_demonstration_is_the_default_one_with_two_effects_more():
    plant = read_plant(resources.files("piezo_sim") / "undeclared.yaml")
    added = [part for part in plant.stage if part not in read_plant().stage]
    assert [type(part) for part in added] == [LogarithmicCreep, ParallelMode]
    assert added[1].frequency_rad_per_s / (2 * np.pi) == pytest.approx(1400.0, rel=1e-3)
    nominal = read_plant()
    for effect in added:
        nominal = add_effect(nominal, effect)
    assert nominal == plant


@pytest.mark.parametrize(
    ("effect", "change"),
    [
        (LogarithmicCreep, {"onset_time_s": 0.0}),
        (LogarithmicCreep, {"memory_s": 0.05}),
        (ThermalDrift, {"time_constant_s": 0.0}),
        (ThermalDrift, {"ambient_walk_k_per_sqrt_s": -1.0}),
        (ParallelMode, {"frequency_rad_per_s": 0.0}),
        (ParallelMode, {"damping_ratio": -0.1}),
        (ParallelMode, {"compliance_share": 1.0}),
        (ParallelMode, {"beside": 0}),
        (TransportDelay, {"delay_s": -1e-6}),
        (DistributedLag, {"lag_s": 0.0}),
        (DistributedLag, {"sections": 0}),
        (TransducerCurve, {"reach_um": 0.0}),
        (MainsHum, {"frequency_hz": 0.0}),
        (MainsHum, {"amplitudes_um": ()}),
        (MainsHum, {"phase_walk_rad_per_sqrt_s": -0.1}),
        (CurrentLimit, {"sink_current_a": 0.0}),
        (CurrentLimit, {"capacitance_f": 0.0}),
        (SoftSaturation, {"low_v": 100.0}),
        (SoftSaturation, {"knee_v": 0.0}),
        (SwitchingDelay, {"reference_speed_v_per_s": 0.0}),
        (SwitchingDelay, {"averaging_time_s": 0.0}),
        (HardeningSpring, {"hardening_length_um": 0.0}),
        (GuideSpring, {"hardening_length_um": 0.0}),
        (GuideSpring, {"damping_ratio": 0.0}),
        (GuideSpring, {"frequency_rad_per_s": -1.0}),
        (SoftBacklash, {"half_gap_um": 0.0}),
        (Spikes, {"rate_per_s": 0.0}),
        (Spikes, {"height_spread": -1.0}),
        (SelfHeating, {"heating_k_per_um": -1.0}),
        (SelfHeating, {"cooling_time_constant_s": 0.0}),
        (IntermittentContact, {"lost_share": 1.1}),
        (IntermittentContact, {"mean_loose_time_s": 0.0}),
        (Depolarisation, {"lost_gain": 1.0}),
        (Depolarisation, {"travel_um": 0.0}),
    ],
)
def test_impossible_parameters_are_refused(effect, change):
    example = next(one for one in EXAMPLES if type(one) is effect)
    with pytest.raises(PlantConfigError, match=f"{effect.name}: .* must"):
        dataclasses.replace(example, **change)
