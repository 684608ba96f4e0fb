# SPDX-License-Identifier: BSD-3-Clause
"""A stage that was never cycled: plays that begin undisplaced, whose remanence is known exactly."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from piezo_identification.adequacy.component_adequacy import adequacy_of
from piezo_identification.estimators.hysteresis.first_rise_fit import (
    LARGEST_ERROR_RATIO,
    estimate_first_rise,
    without_first_rise,
)
from piezo_identification.identification import identify as identify_module
from piezo_identification.identification.estimated_loops import (
    DensityOptions,
    estimate_hysteresis_of,
    estimate_loops,
)
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_identification.prediction import predict
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

PERIOD_S, NOISE_UM = 0.02, 0.003
CYCLE_V = (0.0, 60.0, 0.0)
GRID = DensityOptions(40, 1e-10, 1e-10)


def ways(turns_v, samples=90):
    parts = [np.linspace(start, end, samples, endpoint=False) for start, end in pairwise(turns_v)]
    return np.concatenate([*parts, turns_v[-1:]])


HARMONICS_V = ways([v for top in np.linspace(2.0, 60.0, 30) for v in (0.0, top)] + [0.0])
TWICE_V = ways([0.0, 60.0, 0.0, 60.0, 20.0, 40.0, 0.0], 400)


@pytest.fixture(scope="module")
def stage(independent_stage):
    return independent_stage((), ())


def true_remanence_um(stage, highest_v):
    """What is left at 0 V of plays that have followed a rise from rest up to a voltage."""
    driven_v = highest_v + 1e-3 * highest_v**2
    width_v = stage.half_widths_v
    return 0.02 * np.exp(-width_v / 20.0) @ np.minimum(
        np.maximum(driven_v - width_v, 0.0), width_v)


@pytest.mark.parametrize("voltage_v", [HARMONICS_V, TWICE_V], ids=["harmonics", "twice"])
def test_the_remanence_is_that_of_the_plays(stage, voltage_v):
    noise = NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    found = estimate_first_rise(voltage_v, stage.hysteresis_um(voltage_v) + noise)
    truth_um = [true_remanence_um(stage, v) for v in found.voltages_v[1:]]
    whole_um = true_remanence_um(stage, 60.0)
    assert np.abs(np.subtract(found.remanence_um[1:], truth_um)).max() < 0.03 * whole_um
    assert found.whole_um == pytest.approx(whole_um, rel=0.03)


@pytest.mark.parametrize("voltage_v", [HARMONICS_V, TWICE_V], ids=["harmonics", "twice"])
def test_a_cycled_stage_shows_none(stage, voltage_v):
    displacement_um = stage.hysteresis_um(np.concatenate([CYCLE_V, voltage_v]))[len(CYCLE_V):]
    noise = NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    assert estimate_first_rise(voltage_v, displacement_um + noise) is None


def test_a_single_loop_does_not_tell_it_from_the_hysteresis(stage):
    voltage_v = ways([0.0, 60.0, 0.0], 500)
    assert estimate_first_rise(voltage_v, stage.hysteresis_um(voltage_v)) is None


@pytest.fixture(scope="module")
def virgin(stage, recorded):
    return recorded("virgin", HARMONICS_V, stage.displacement_um(HARMONICS_V, PERIOD_S), PERIOD_S,
                    NOISE_UM)


@pytest.fixture(scope="module")
def loops(virgin):
    density, first_rise, cycled = estimate_loops(
        {"hysteresis": virgin}, LinearDynamics(), GRID)
    return density, first_rise, cycled["hysteresis"]


def test_the_loops_beside_it_are_those_of_the_cycled_stage(stage, recorded, virgin, loops):
    density, first_rise, cycled = loops
    assert first_rise.whole_um == pytest.approx(true_remanence_um(stage, 60.0), rel=0.03)
    truth_um = stage.displacement_um(HARMONICS_V, PERIOD_S, CYCLE_V)
    difference_um = cycled.displacement_um - truth_um
    assert np.std(difference_um) < 0.01 * np.ptp(truth_um)
    model = StageModel(density.model(), CreepDynamics(), ElectricVibrationDynamics(),
                       first_rise=first_rise)
    plain = replace(model, first_rise=None)
    voltage_v = ways([0.0, 45.0, 15.0, 60.0, 30.0, 50.0, 0.0])
    after = recorded("after", voltage_v, stage.displacement_um(voltage_v, PERIOD_S, CYCLE_V),
                     PERIOD_S, NOISE_UM)
    # Once the stage is cycled, nothing of it shows; before, only the component explains it.
    assert predict(model, after).e_y_percent() == predict(plain, after).e_y_percent() < 0.5
    assert predict(model, virgin).e_y_percent() < 0.3 * predict(plain, virgin).e_y_percent()
    assert simulated_recording(model, virgin).simulate() == pytest.approx(
        predict(model, virgin).simulated_um, abs=0.05)
    assert adequacy_of(model, {"hysteresis": virgin})["hysteresis"].error_percent < (
        0.3 * adequacy_of(plain, {"hysteresis": virgin})["hysteresis"].error_percent)


def test_each_of_several_recordings_begins_as_its_stage_was(stage, recorded, virgin, loops):
    """Inner loops recorded on a stage never cycled, and on one that was: each as it began."""
    inner_v = ways([0.0, 45.0, 15.0, 40.0, 0.0, 50.0, 20.0, 0.0])

    def inner(name, past_v):
        return recorded(name, inner_v, stage.displacement_um(inner_v, PERIOD_S, past_v), PERIOD_S,
                        NOISE_UM)

    given = {"hysteresis": inner("never", ()), "hysteresis 2": virgin,
             "hysteresis 3": inner("before", CYCLE_V)}
    _, first_rise, cycled = estimate_loops(given, LinearDynamics(), GRID)
    assert first_rise.whole_um == pytest.approx(true_remanence_um(stage, 60.0), rel=0.03)
    assert cycled["hysteresis 3"] is given["hysteresis 3"]
    difference_um = (cycled["hysteresis"].displacement_um
                     - stage.displacement_um(inner_v, PERIOD_S, CYCLE_V))
    assert np.std(difference_um) < 0.01 * np.ptp(inner_v)


def test_a_model_that_begins_with_the_first_rise_gives_it(stage, loops):
    density, first_rise, _ = loops
    model = StageModel(density.model(), CreepDynamics(), ElectricVibrationDynamics(),
                       first_rise=first_rise)
    memory = model.memory(highest_v=0.0)
    parts_um = [model.simulate(part, PERIOD_S, memory) for part in np.split(TWICE_V, [300, 900])]
    simulated_um = np.concatenate(parts_um)
    truth_um = stage.displacement_um(TWICE_V, PERIOD_S)
    assert np.std(simulated_um - truth_um) < 0.01 * np.ptp(truth_um)
    assert memory.highest_v == 60.0


def test_noise_as_large_as_the_error_without_it_does_not_hide_it(stage, recorded):
    noisy = recorded("noisy", HARMONICS_V, stage.displacement_um(HARMONICS_V, PERIOD_S), PERIOD_S,
                     0.5)
    _, first_rise, _ = estimate_loops({"hysteresis": noisy}, LinearDynamics(), GRID)
    assert first_rise.whole_um == pytest.approx(true_remanence_um(stage, 60.0), rel=0.03)


def test_it_is_not_taken_for_drift(recorded, stage):
    """A cycled stage that drifts upwards: the loops beside a remanence are hardly better."""
    voltage_v = np.concatenate([HARMONICS_V, HARMONICS_V])
    displacement_um = stage.displacement_um(voltage_v, PERIOD_S, CYCLE_V)
    drift_um = np.linspace(0.0, 0.3, voltage_v.size)
    drifts = recorded("drifts", voltage_v, displacement_um + drift_um, PERIOD_S, NOISE_UM)
    _, first_rise, _ = estimate_loops({"hysteresis": drifts}, LinearDynamics(), GRID)
    assert first_rise is None


@pytest.fixture(scope="module")
def small_first_rise(independent_stage):
    """A stage, its creep, and the voltage of loops that the remainder of creep may explain."""
    rates, gains = (0.1, 0.5, 2.0, 5.0, 12.0), (0.02, 0.02, 0.02, 0.02, 0.02)
    stage = independent_stage(rates, gains)
    stage.half_widths_v = np.linspace(1.0, 10.0, 4)
    numerator = np.poly(-np.array(rates))
    for place, (rate, gain) in enumerate(zip(rates, gains, strict=True)):
        numerator = np.polyadd(
            numerator, gain * rate * np.poly(-np.delete(np.array(rates), place)))
    turns_v = [0.0, 60.0, 0.0, *(v for low in range(6, 60, 6) for v in (60.0, low)), 0.0]
    creep = CreepDynamics(rates, tuple(np.sort(-np.roots(numerator))))
    return stage, LinearDynamics(creep=creep), ways(turns_v, 100)


def test_creep_shows_what_loops_explain_by_the_remainder_of_earlier_creep(
        small_first_rise, recorded):
    stage, linear, loops_v = small_first_rise
    steps_v = np.repeat([0.0, 40.0, 10.0, 60.0], 200)
    given = {"hysteresis": recorded(
        "loops", loops_v, stage.displacement_um(loops_v, 0.01), 0.01, NOISE_UM)}
    _, alone, _ = estimate_loops(given, linear, GRID)
    given["creep"] = recorded(
        "steps", steps_v, stage.displacement_um(steps_v, 0.1), 0.1, NOISE_UM)
    _, first_rise, _ = estimate_loops(given, linear, GRID)
    assert alone is None
    assert first_rise.whole_um == pytest.approx(true_remanence_um(stage, 60.0), rel=0.1)


@pytest.mark.long
def test_first_rise_that_the_separate_steps_miss_is_found_by_the_one_fit(
        small_first_rise, monkeypatch):
    stage, _, loops_v = small_first_rise
    monkeypatch.setattr(identify_module, "estimate_loops", lambda recordings, *others: (
        estimate_hysteresis_of(recordings, *others), None, recordings))

    def played(voltage_v, period_s):
        noise = NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
        return recording_of({
            "time_s": period_s * np.arange(voltage_v.size), "voltage_v": voltage_v,
            "displacement_um": stage.displacement_um(voltage_v, period_s) + noise})

    identified = identify_module.identify(
        creep=played(np.repeat([0.0, 40.0, 10.0, 60.0], 200), 0.1),
        hysteresis=played(loops_v, 0.01), density=GRID)
    assert identified.model.first_rise.whole_um == pytest.approx(
        true_remanence_um(stage, 60.0), rel=0.2)


def test_what_is_taken_off_is_what_the_component_lacks(virgin, loops):
    _, first_rise, _ = loops
    left = without_first_rise(virgin, first_rise, CreepDynamics(), ElectricVibrationDynamics())
    taken_um = virgin.displacement_um - left.displacement_um
    assert taken_um[0] == pytest.approx(-first_rise.whole_um)
    assert taken_um[-1] == 0.0
    assert 0.0 < LARGEST_ERROR_RATIO < 1.0


def test_loops_that_never_come_back_to_the_lowest_voltage_show_no_first_rise():
    turns_v = [0.0, 100.0, 10.0, 90.0, 20.0, 80.0]
    voltage_v = np.interp(np.linspace(0.0, 5.0, 500), np.arange(6), turns_v)
    assert estimate_first_rise(voltage_v, 0.2 * voltage_v, 60.0) is None
