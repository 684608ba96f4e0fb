# SPDX-License-Identifier: BSD-3-Clause
"""A reference is the same in whatever pieces it is sampled."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_controller.references.reference import Reference, trajectory
from piezo_controller.references.sines import triangle_wave
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_controller.references.trajectory import (
    FormulaTrajectory,
    JoinedTrajectory,
    KeptTrajectory,
)

HOUR = 3600 * 40_000
ENDLESS = {
    "harmonic": Reference("harmonic", (0.0123,), (40.0,), (0.3,), 50.0),
    "multi_frequency": Reference("multi_frequency", (33.37, 99.1), (20.0, 3.0), (), 50.0),
    "triangle": Reference("triangle", (0.0123,), (40.0,), (1.0,), 50.0),
    "raster, fast": Reference("raster", (0.01,), (40.0,), (), 50.0),
    "raster, slow": Reference("raster", (100.0,), (40.0,), (), 50.0, axis="slow"),
    "random": Reference("random", (20.0, 500.0), (40.0,), (), 50.0, seed=7),
    "slow random": Reference("random", (0.05,), (40.0,), (), 50.0, seed=7),
}


def joined():
    parts = [trajectory(ENDLESS[kind]) for kind in ("harmonic", "random", "triangle")]
    return JoinedTrajectory(parts, [3000, 2000, 4000], 2000)


@pytest.mark.parametrize("make", [
    *(lambda reference=reference: trajectory(reference) for reference in ENDLESS.values()),
    joined, lambda: KeptTrajectory(joined())], ids=[*ENDLESS, "joined", "kept"])
@settings(max_examples=10, deadline=None)
@given(begin=st.one_of(st.integers(-9000, 9000), st.integers(HOUR - 9000, HOUR)),
       lengths=st.lists(st.integers(1, 5000), min_size=1, max_size=8))
def test_pieces_of_random_lengths_are_the_whole(make, begin, lengths):
    whole = make().sample(begin, sum(lengths))
    one, at, pieces = make(), begin, []
    for length in lengths:
        pieces.append(one.sample(at, length))
        at += length
    np.testing.assert_allclose(np.concatenate(pieces), whole, atol=1e-10, rtol=0)


@pytest.mark.parametrize("kind", ENDLESS)
def test_survey_shows_the_travel_of_an_hour_in_few_samples(kind):
    values = trajectory(ENDLESS[kind]).survey(HOUR)
    assert values.size <= 100_000
    low, high = {"multi_frequency": (22.0, 23.01), "raster, fast": (43.0, 48.0)}.get(
        kind, (25.0, 40.01))
    assert low < np.ptp(values) < high


def test_joined_trajectories_are_themselves_outside_the_transitions():
    parts = [FormulaTrajectory(lambda at: np.sin(at / 20)),
             FormulaTrajectory(lambda at: 3.0 + np.cos(at / 30))]
    both = JoinedTrajectory(parts, [500, 700], 100)
    values = both.sample(-50, 1250)
    at = np.arange(-50, 1200)
    np.testing.assert_array_equal(values[:550], np.sin(at[:550] / 20))
    np.testing.assert_array_equal(values[650:], 3.0 + np.cos((at[650:] - 500) / 30))
    first, second = np.sin(at[550:650] / 20), 3.0 + np.cos((at[550:650] - 500) / 30)
    np.testing.assert_allclose(values[550:650], first + minimum_jerk(100) * (second - first))
    assert np.ptp(both.survey(1200)) == pytest.approx(np.ptp(values[50:]), rel=1e-3)


def test_kept_trajectory_computes_a_block_once_and_forgets_the_oldest():
    asked = []

    def formula(at):
        asked.append(at[0])
        return at.astype(float)

    kept = KeptTrajectory(FormulaTrajectory(formula))
    for first in range(0, 400_000, 40):
        np.testing.assert_array_equal(kept.sample(first, 40), np.arange(first, first + 40))
    assert asked == list(range(0, 400_000, 4000))
    kept.sample(0, 1)
    assert asked[-1] == 0


def test_kept_block_is_given_while_another_thread_computes_the_next():
    begun, go_on = threading.Event(), threading.Event()

    def formula(at):
        if at[0] == 4000:
            begun.set()
            assert go_on.wait(60.0)
        return at.astype(float)

    kept = KeptTrajectory(FormulaTrajectory(formula))
    kept.sample(0, 40)
    with ThreadPoolExecutor(2) as threads:
        computing = threads.submit(kept.sample, 4000, 40)
        assert begun.wait(60.0)
        try:
            given = threads.submit(kept.sample, 40, 40).result(60.0)
        finally:
            go_on.set()
        np.testing.assert_array_equal(given, np.arange(40.0, 80.0))
        np.testing.assert_array_equal(computing.result(60.0), np.arange(4000.0, 4040.0))


@pytest.mark.parametrize("frequency_hz", [0.1, 1.7, 1.99, 2.01, 700.0])
def test_slow_triangle_is_the_series_whatever_its_number_of_terms(frequency_hz):
    tips = np.pi / 2 + np.linspace(-0.02, 0.02, 500)
    angle_rad = np.r_[np.linspace(-20.0, 20.0, 2000), tips, tips + np.pi]
    orders = np.arange(1, 2000.0 / frequency_hz + 1e-9, 2)
    orders = orders if orders.size else np.ones(1)
    series = sum(np.sin(k * angle_rad) * (-1) ** (k // 2) / k**2 for k in orders)
    np.testing.assert_allclose(triangle_wave(angle_rad, frequency_hz),
                               series / np.sum(1 / orders**2), atol=1e-9)


def test_long_file_is_mapped_and_not_held(tmp_path):
    path, count = tmp_path / "way.csv", 250_000
    time_s = np.arange(count) / 40_000
    np.savetxt(path, np.column_stack([time_s, np.sin(time_s)]), fmt="%.9f", delimiter=",",
               header="time_s,displacement_um", comments="")
    told = []
    way = trajectory(Reference("file", file=str(path), once=True), watch=told.append)
    np.testing.assert_allclose(way.sample(240_000, 20_000),
                               np.sin(np.minimum(np.arange(240_000, 260_000), count - 1) / 40_000),
                               atol=1e-8)
    assert len(told) == 3 and told[-1] > 0.99

    def end(fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trajectory(Reference("file", file=str(path), once=True), watch=end)
