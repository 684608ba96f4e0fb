# SPDX-License-Identifier: BSD-3-Clause
"""Loops of another kind than a Preisach hysteresis: their own form is found and predicts."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from piezo_identification import identify
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.prediction import unseen_errors
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.model_summary import main_results
from piezo_recorder import recording_of

pytestmark = pytest.mark.kernels

PERIOD_S, NOISE_UM, GAIN_UM_PER_V = 0.02, 0.005, 0.2
SATURATION_V, RELAXATION_V = 5.0, 20.0


def turning(levels_v, rows):
    along = np.r_[0.0, np.cumsum(np.abs(np.diff(levels_v)))]
    return np.interp(np.linspace(0.0, along[-1], rows), along, levels_v)


def curve_um(acting_v):
    return GAIN_UM_PER_V * (acting_v + 0.002 * (acting_v - 50.0) ** 2)


def measured(voltage_v, seed, taken_v=0.0, saturation_v=SATURATION_V, is_beside=False,
             widening_per_v=0.0):
    """Solve L dz = S g dv - z |dv|, with g = 1 + w (v - 50 V), row by row; add noise.

    Without w, this is the equation of Dahl, and with w one of Coleman and Hodgdon. The curve acts
    on the remaining voltage, or the hysteresis is beside it.
    """
    def tends_to_v(at_v, way_v):
        return (math.copysign(saturation_v, way_v) * (1.0 + widening_per_v * (at_v - 50.0))
                - saturation_v * RELAXATION_V * widening_per_v)

    taken_v = [taken_v]
    for before_v, after_v in pairwise(voltage_v.tolist()):
        way_v = after_v - before_v
        left_v = taken_v[-1] - tends_to_v(before_v, way_v)
        taken_v.append(tends_to_v(after_v, way_v)
                       + left_v * math.exp(-abs(way_v) / RELAXATION_V))
    noise_um = NOISE_UM * np.random.default_rng(seed).standard_normal(voltage_v.size)
    moved_um = (curve_um(voltage_v) - GAIN_UM_PER_V * np.array(taken_v) if is_beside
                else curve_um(voltage_v - taken_v))
    return recording_of({"time_s": np.arange(voltage_v.size) * PERIOD_S, "voltage_v": voltage_v,
                         "displacement_um": moved_um + noise_um})


def identified_from_loops(saturation_v=SATURATION_V, note=lambda _: None):
    """Identify a stage from loops, and from larger steps that show no shape of a loop."""
    steps_v = np.repeat([50.0, 1.0, 99.0, 50.0], 30)
    sizes_v = np.linspace(48.0, 4.0, 12)
    levels_v = 50.0 + np.r_[0.0, np.column_stack([sizes_v, -sizes_v]).ravel(), 0.0]
    steps, loops = (measured(voltage_v, seed, 0.0, saturation_v) for voltage_v, seed in (
        (steps_v, 4), (turning(levels_v, 1000), 1)))
    return identify(creep=steps, hysteresis=loops, density=DensityOptions(20, 1e-10, 1e-10),
                    note=note)


@pytest.fixture(scope="module")
def identified():
    return identified_from_loops()


def test_the_equation_is_found_with_its_parameters(identified):
    [loops] = identified.model.effects
    assert isinstance(loops, BoucWenHysteresis)
    assert identified.adequacy["hysteresis"]["verdict"] == "adequate"
    assert loops.saturation_v == pytest.approx(SATURATION_V, rel=0.02)
    assert loops.relaxation_v == pytest.approx(RELAXATION_V, rel=0.02)
    assert loops.unloading == pytest.approx(1.0, abs=0.05)


def test_small_loops_off_the_centre_are_predicted(identified):
    levels_v = [50.0, 80.0, 60.0, 75.0, 20.0, 40.0, 25.0, 90.0, 70.0, 85.0, 50.0]
    unseen = measured(turning(levels_v, 800), 2)
    noise_percent = 100.0 * NOISE_UM / np.std(unseen.displacement_um)
    assert unseen_errors(identified.model, unseen)["e_y_percent"] < 1.5 * noise_percent


@pytest.mark.parametrize("taken_v", [-4.0, 3.0])
def test_the_past_of_a_recording_is_found(identified, taken_v):
    levels_v = [50.0, 55.0, 48.0, 56.0, 47.0, 53.0, 50.0]
    unseen = measured(turning(levels_v, 400), 3, taken_v)
    noise_percent = 100.0 * NOISE_UM / np.std(unseen.displacement_um)
    assert unseen_errors(identified.model, unseen)["e_y_percent"] < 1.5 * noise_percent


def test_loops_that_go_back_are_not_written_and_the_reason_is_reported():
    notes = []
    model = identified_from_loops(saturation_v=0.55 * RELAXATION_V, note=notes.append).model
    assert not any(isinstance(effect, BoucWenHysteresis) for effect in model.effects)
    assert any("better than the model that is written, but the stage would go back" in each
               for each in notes)


def test_the_summary_does_not_say_that_there_is_no_hysteresis(identified):
    assert "with a hysteresis in front of a curve" in str(main_results(identified))
    assert identified.model.has_hysteresis
    assert not replace(identified.model, effects=()).has_hysteresis


@pytest.mark.parametrize("widening_per_v", [0.0, 0.008])
def test_a_hysteresis_beside_a_curve_is_found_after_cycles_that_were_not_recorded(widening_per_v):
    turns_v = [0.0, 100.0, 0.0, *np.ravel([(100.0 - size, size) for size in range(6, 48, 6)]),
               0.0, 100.0, 30.0, 100.0, 60.0, 100.0, 0.0]
    after_cycles_v = -SATURATION_V * (1.0 + widening_per_v * (RELAXATION_V - 50.0))
    stage = {"taken_v": after_cycles_v, "is_beside": True, "widening_per_v": widening_per_v}
    loops = measured(turning(turns_v, 1500), 1, **stage)
    model = identify(hysteresis=loops, density=DensityOptions(20, 1e-10, 1e-10)).model
    [effect] = model.effects
    assert isinstance(effect, CurvedBoucWenHysteresis)
    assert effect.relaxation_v == pytest.approx(RELAXATION_V, rel=0.02)
    assert effect.curvature_per_v == pytest.approx(0.002, rel=0.05)
    assert effect.growth_slope_per_v == pytest.approx(widening_per_v, abs=5e-4)
    unseen = measured(turning([0.0, 85.0, 20.0, 70.0, 40.0, 95.0, 10.0, 0.0], 900), 2, **stage)
    noise_percent = 100.0 * NOISE_UM / np.std(unseen.displacement_um)
    assert unseen_errors(model, unseen)["e_y_percent"] < 1.5 * noise_percent


def magnetised(voltage_v):
    """Solve k dm = |dv| (L(v) - m) where m moves with the voltage: Jiles and Atherton (1986)."""
    fine_v = np.interp(np.arange(0.0, voltage_v.size, 0.02), np.arange(voltage_v.size), voltage_v)
    off = (fine_v - 49.999) / 30.0
    tends_to = 1.0 / np.tanh(off) - 1.0 / off
    part, parts = float(tends_to[0]), []
    for way_v, target in zip(np.diff(fine_v, prepend=fine_v[0]).tolist(), tends_to.tolist(),
                             strict=True):
        if way_v * (target - part) > 0.0:
            part += (target - part) * -math.expm1(-abs(way_v) / 12.0)
        parts.append(part)
    return np.array(parts[::50])


def test_domains_that_saturate_are_approximated_to_the_noise():
    def measured_after_cycles(levels_v, rows, seed):
        voltage_v = turning([0.0, 100.0, 0.0, *levels_v], rows)
        noise_um = NOISE_UM * np.random.default_rng(seed).standard_normal(rows)
        moved_um = GAIN_UM_PER_V * (voltage_v + 40.0 * magnetised(voltage_v))
        return recording_of({"time_s": np.arange(rows) * PERIOD_S, "voltage_v": voltage_v,
                             "displacement_um": moved_um + noise_um})

    sizes_v = np.linspace(48.0, 4.0, 12)
    levels_v = 50.0 + np.r_[np.column_stack([sizes_v, -sizes_v]).ravel(), 0.0]
    loops = measured_after_cycles([*levels_v, 100.0, 30.0, 100.0, 60.0, 100.0, 0.0], 2000, 5)
    model = identify(hysteresis=loops, density=DensityOptions(20, 1e-10, 1e-10)).model
    unseen = measured_after_cycles(
        [85.0, 20.0, 70.0, 40.0, 95.0, 10.0, 60.0, 30.0, 45.0, 0.0], 1000, 6)
    noise_percent = 100.0 * NOISE_UM / np.std(unseen.displacement_um)
    assert unseen_errors(model, unseen)["e_y_percent"] < 1.5 * noise_percent
