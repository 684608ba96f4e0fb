# SPDX-License-Identifier: BSD-3-Clause
"""What remains passes only the least noise that any recording of the sensor shows."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.diagnosis.evidence.ceiling import Ceiling
from piezo_identification.diagnosis.evidence.known_noise import KnownNoise, NoiseSource
from piezo_identification.diagnosis.joint.remainder import held_to_noise, held_to_prediction
from piezo_identification.fitting.model_weights import HeldOut, Remainder

PERIOD_S = 1e-4
QUIET = NoiseSource(0.044, PERIOD_S, "rests.csv")
KNOWN = KnownNoise((QUIET,))
SURE = {"none": 0.95, "something_else": 0.05}


def remainder(rms_um, name="data.csv"):
    left_um = rms_um * np.random.default_rng(1).normal(size=3000)
    return Remainder(name, HeldOut(left_um, np.arange(3000) // 100), PERIOD_S, 10.0, 3.0)


def held(*remainders, known=KNOWN, finds_nothing=True):
    return held_to_noise(SURE, remainders, known, 0.0, finds_nothing)


def test_what_passes_the_least_noise_changes_nothing():
    assert held(remainder(0.044)).probabilities == pytest.approx(SURE)


def test_many_times_the_noise_of_another_recording_are_something_else():
    found = held(remainder(1.0))
    assert found.probabilities["something_else"] > 0.99
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    assert "times the noise of 44 nm RMS that rests.csv shows" in found.sentence


def test_the_error_of_the_hold_out_enters():
    found = held(remainder(0.044), remainder(1.0, "held_out.csv"))
    assert found.probabilities["something_else"] > 0.99
    assert "What remains of held_out.csv" in found.sentence


def test_noise_of_slower_rows_is_that_of_means():
    slow = KnownNoise((NoiseSource(0.044, 100.0 * PERIOD_S, "slow.csv"),))
    assert held(remainder(0.44), known=slow).probabilities == pytest.approx(SURE)


@pytest.mark.parametrize(("inadequate", "finds_nothing", "is_contradicted"), [
    ((), True, False), (("hysteresis",), True, True), (("hysteresis",), False, False)])
def test_an_inadequate_component_excuses_nothing(inadequate, finds_nothing, is_contradicted):
    """7e-5 of the travel pass for a good model, but not for one that is called inadequate."""
    known = KnownNoise((NoiseSource(1e-6, PERIOD_S, "quiet.csv"),), inadequate)
    found = held(remainder(7e-4), known=known, finds_nothing=finds_nothing)
    assert (found.probabilities["something_else"] > 0.99) is is_contradicted
    assert ("hysteresis" in found.sentence) is is_contradicted


@pytest.mark.parametrize(("times", "passes"), [(1.4, True), (10.0, False)])
def test_an_inadequate_component_excuses_what_is_less_than_the_noise(times, passes):
    """The identification has called inadequate what it left: as much as remains here."""
    known = KnownNoise((QUIET,), ("hysteresis",))
    left = replace(remainder(times * QUIET.rms_um), motion_um=300.0)
    found = held_to_noise(SURE, [left], known, times * QUIET.rms_um, finds_nothing=True)
    assert (found.probabilities["something_else"] < 0.5) is passes


@pytest.mark.parametrize(("predicted_um", "passes"), [(0.0, True), (0.2, True), (0.5, False)])
def test_what_follows_from_the_voltage_is_no_noise(predicted_um, passes):
    left = remainder(1.0)
    ceiling = Ceiling(1.0, predicted_um, predicted_um, np.sqrt(1.0 - predicted_um**2), 1.0)
    found = held_to_prediction(held(left, known=KnownNoise((replace(QUIET, rms_um=1.0),))),
                               ceiling, [left], 0.0)
    assert (found.probabilities["something_else"] < 0.5) is passes
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    assert "in which the voltage rests" in found.sentence


def test_what_follows_from_the_voltage_passes_where_a_good_model_errs_as_much():
    left = replace(remainder(1.0), travel_um=1e4)
    ceiling = Ceiling(1.0, 0.7, 0.7, 0.71, 1.0)
    known = KnownNoise((replace(QUIET, rms_um=1.0),))
    found = held_to_prediction(held(left, known=known), ceiling, [left], 0.0)
    assert found.probabilities["something_else"] < 0.5


@pytest.mark.parametrize(("source", "is_shown"), [
    (QUIET, True), (replace(QUIET, is_shown=False), False),
    (replace(QUIET, period_s=10.0 * PERIOD_S), False),
    (replace(QUIET, period_s=0.1 * PERIOD_S), True)],
    ids=["the same rows", "a bound", "slower rows", "faster rows"])
def test_noise_is_known_where_rows_as_fast_show_it(source, is_shown):
    assert KnownNoise((source,)).is_shown(PERIOD_S) is is_shown
