# SPDX-License-Identifier: BSD-3-Clause
"""The plays of the plant `beam`: their law, what they forget, and where they leave Preisach."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from piezo_sim.effects.generalised_plays import GeneralisedPlays, PlaysRunner
from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import read_plant

BEAM = next(effect for effect in read_plant("beam").stage if isinstance(effect, GeneralisedPlays))
LOW_V, TOP_V = -20.0, 120.0
SLOWLY_S = 1.0  # against microseconds of viscosity

unhurried = settings(deadline=None)  # the first example may compile
voltages = st.floats(LOW_V, TOP_V)


def output_um(*voltage_v, effect=BEAM, sample_period_s=SLOWLY_S):
    runner = PlaysRunner(effect, sample_period_s)
    samples = np.array(voltage_v, dtype=float)
    runner.apply(samples)
    return samples


def polarisation_um(*voltage_v):
    """Output before the quadratic law, with the same plays."""
    straight = dataclasses.replace(BEAM, curvature_per_um=0.0, offset_um=0.0)
    return output_um(*voltage_v, effect=straight)


def envelopes_v(voltage_v, threshold_v, effect=BEAM):
    deviation_v = voltage_v - effect.envelope_centre_v
    middle_v = effect.envelope_scale_v * math.tanh(deviation_v / effect.envelope_scale_v)
    half_v = threshold_v * (1.0 + effect.threshold_growth_per_v * deviation_v)
    return middle_v - half_v, middle_v + half_v


def test_one_play_moves_along_its_envelopes_and_stands_between_them():
    one = dataclasses.replace(
        BEAM, plays=1, threshold_shape=1.0, instant_gain_um_per_v=0.0, play_gain_um_per_v=1.0,
        curvature_per_um=0.0, offset_um=0.0)
    threshold_v = one.threshold_scale_v * math.log(2.0)  # the median of an exponential law
    assert one.thresholds_v() == pytest.approx([threshold_v])
    rising, falling = (
        [envelopes_v(voltage_v, threshold_v, one)[side] for voltage_v in ends]
        for side, ends in ((0, (60.0, 110.0)), (1, (40.0, LOW_V))))
    path = output_um(60.0, 110.0, 90.0, 40.0, LOW_V, -10.0, effect=one)
    assert path == pytest.approx([*rising, rising[1], *falling, falling[1]], abs=1e-9)


def test_thresholds_are_no_grid():
    thresholds_v = BEAM.thresholds_v()
    gaps_v = np.diff(thresholds_v)
    assert thresholds_v.size == BEAM.plays
    assert np.unique(np.round(gaps_v, 6)).size == gaps_v.size
    assert gaps_v.max() > 5.0 * gaps_v.min() > 0.0
    # Quantiles of the Weibull law: its median is scale * (ln 2)^(1 / shape).
    median_v = BEAM.threshold_scale_v * math.log(2.0) ** (1.0 / BEAM.threshold_shape)
    assert np.median(thresholds_v) == pytest.approx(median_v, rel=0.01)


@unhurried
@given(
    st.lists(voltages, min_size=1, max_size=10),
    st.lists(voltages, min_size=1, max_size=10),
    st.tuples(voltages, voltages).map(sorted),
)
def test_loops_are_congruent_before_the_quadratic_law_and_differ_by_it_behind(
        one_v, other_v, ends_v):
    loop_v = [ends_v[1], ends_v[0], ends_v[1]]
    heights_um, factors = [], []
    for history_v in (one_v, other_v):
        low_um, high_um = polarisation_um(*history_v, *loop_v)[-2:]
        heights_um.append(high_um - low_um)
        factors.append(1.0 + BEAM.curvature_per_um * (low_um + high_um))
    assert heights_um[0] == pytest.approx(heights_um[1], abs=1e-9)
    for history_v, height_um, factor in zip((one_v, other_v), heights_um, factors, strict=True):
        low_um, high_um = output_um(*history_v, *loop_v)[-2:]
        assert high_um - low_um == pytest.approx(height_um * factor, abs=1e-9)


def test_the_same_loop_on_both_branches_differs_by_two_percent_of_its_height():
    on_the_way_up, on_the_way_down = (
        np.ptp(output_um(*history_v, 60.0, 40.0, 60.0)[-2:])
        for history_v in ((LOW_V,), (LOW_V, TOP_V)))
    assert on_the_way_down / on_the_way_up - 1.0 == pytest.approx(0.02, abs=0.003)


def test_thresholds_grow_with_the_rate_as_viscosity_says():
    # A ramp at the rate g leaves a play behind its envelope by g times the viscous time.
    period_s, rate_v_per_s = 1e-8, 2e5
    straight = dataclasses.replace(
        BEAM, plays=1, instant_gain_um_per_v=0.0, play_gain_um_per_v=1.0, curvature_per_um=0.0,
        offset_um=0.0, envelope_scale_v=1e9, threshold_growth_per_v=0.0)
    ramp_v = np.arange(LOW_V, TOP_V, rate_v_per_s * period_s)
    envelope_v = ramp_v[-1] - straight.envelope_centre_v - straight.thresholds_v()[0]
    behind_v = envelope_v - output_um(*ramp_v, effect=straight, sample_period_s=period_s)[-1]
    assert behind_v == pytest.approx(rate_v_per_s * BEAM.viscous_time_s, rel=2e-3)


def test_held_voltages_give_the_solution_of_the_differential_equation():
    period_s = 2.5e-5
    voltage_v = 50.0 + 60.0 * np.sin(np.arange(60) * 0.4)
    threshold_v = BEAM.thresholds_v()[12]
    play_v = envelopes_v(LOW_V, threshold_v)[1]
    for level_v in voltage_v:
        low_v, high_v = envelopes_v(level_v, threshold_v)
        play_v = solve_ivp(
            lambda _, w, low_v=low_v, high_v=high_v: (np.clip(w, low_v, high_v) - w)
            / BEAM.viscous_time_s, (0.0, period_s), [play_v], rtol=1e-9, atol=1e-9).y[0, -1]
    runner = PlaysRunner(BEAM, period_s)
    runner.apply(voltage_v.copy())
    assert runner.plays_v[12] == pytest.approx(play_v, abs=1e-6)


def test_the_stage_has_the_gain_and_the_loop_of_the_thesis():
    sweep_v = np.linspace(LOW_V, TOP_V, 1401)
    up_um = output_um(*sweep_v)
    down_um = output_um(TOP_V, *sweep_v[::-1])[:0:-1]
    travel_um = up_um[-1] - up_um[0]
    assert travel_um == pytest.approx(133.0, abs=2.0)
    assert np.max(down_um - up_um) / travel_um == pytest.approx(0.12, abs=0.01)
    assert abs(output_um(0.0)[0]) < 0.01


@pytest.mark.parametrize("change", [
    {"plays": 0}, {"threshold_scale_v": 0.0}, {"threshold_shape": -1.0}, {"envelope_scale_v": 0.0},
    {"play_gain_um_per_v": -1.0}, {"viscous_time_s": 0.0},
    {"threshold_growth_per_v": 0.02}, {"curvature_per_um": 0.02},
])
def test_impossible_parameters_are_refused(change):
    with pytest.raises(PlantConfigError, match="generalised_plays: .* must"):
        dataclasses.replace(BEAM, **change)


def test_the_runner_of_the_plant_is_the_one_tested_here():
    assert isinstance(BEAM.start(Surroundings(2.5e-5, 0.0, 1)), PlaysRunner)
