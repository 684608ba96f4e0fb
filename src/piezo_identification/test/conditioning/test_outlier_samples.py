# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.outlier_samples import (
    good_samples,
    with_jump_rows_marked,
    with_outliers_marked,
)
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.experiments import catalogue as experiments
from piezo_recorder import recording_of

MAKERS = {
    "creep": (experiments.creep(), 100.0),
    "dynamics": (experiments.dynamics(duration_s=1.0), 40_000.0),
    "hysteresis": (experiments.hysteresis(level_count=5), 1000.0),
}


@pytest.fixture(scope="module", params=MAKERS)
def recording(request, play):
    experiment, clock_hz = MAKERS[request.param]
    return play(experiment, 1, clock_hz)


def spoilt(recording, share=0.01, height_um=5.0):
    """Return the recording with spikes, and where they are."""
    generator = np.random.default_rng(0)
    wrong = np.flatnonzero(generator.random(recording.voltage_v.size) < share)
    displacement_um = recording.displacement_um.copy()
    displacement_um[wrong] += height_um * generator.choice([-1.0, 1.0], wrong.size)
    return replace(recording, displacement_um=displacement_um), wrong


def test_a_recording_without_outliers_stays_as_it_is(recording):
    kept = with_outliers_marked(recording)
    assert good_samples(kept).all()
    np.testing.assert_array_equal(kept.displacement_um, recording.displacement_um)


def test_spikes_are_put_back_among_their_neighbours(recording):
    broken, wrong = spoilt(recording)
    mended = with_outliers_marked(broken)
    found = np.flatnonzero(~good_samples(mended))
    assert np.isin(found, wrong).mean() > 0.98
    assert np.isin(wrong, found).mean() > 0.9
    before, after = (
        np.sqrt(np.mean((each.displacement_um - recording.displacement_um) ** 2))
        for each in (broken, mended)
    )
    # Those at the steps of a square wave stay.
    assert after < 0.3 * before


def test_a_converters_steps_are_no_outliers(recording):
    step_um = 0.02
    rounded = replace(
        recording, displacement_um=step_um * np.round(recording.displacement_um / step_um))
    assert good_samples(with_outliers_marked(rounded)).all()


def test_dynamics_are_those_without_outliers(plant, play):
    recording = play(experiments.dynamics(duration_s=1.0), 1)
    broken, _ = spoilt(recording, 1e-3, 20.0)
    mended = estimate_dynamics(with_outliers_marked(broken), plant.creep, 2).model
    truth = plant.dynamics
    assert mended.mode_frequencies_rad_per_s == pytest.approx(
        truth.mode_frequencies_rad_per_s, rel=2e-3)
    assert mended.time_constant_s == pytest.approx(truth.time_constant_s, rel=5e-3)


@pytest.mark.parametrize("rows_of_a_level, marked", [(50, True), (1, False)])
def test_first_rows_of_jumps_are_left_out_unless_every_row_is_a_point(rows_of_a_level, marked):
    level_v = np.repeat(np.append(np.arange(0.0, 90.0, 10.0), np.arange(70.0, -1.0, -10.0)),
                        rows_of_a_level)
    recording = with_outliers_marked(recording_of({
        "time_s": 0.1 * np.arange(level_v.size), "voltage_v": level_v,
        "displacement_um": np.append(0.0, level_v[:-1]) + 1e-3 * np.arange(level_v.size)}))
    left_out = np.flatnonzero(~good_samples(with_jump_rows_marked(recording)))
    jumps = np.flatnonzero(np.diff(level_v)) + 1
    np.testing.assert_array_equal(left_out, jumps if marked else [])
