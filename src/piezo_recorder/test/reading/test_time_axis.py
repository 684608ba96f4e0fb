# SPDX-License-Identifier: BSD-3-Clause
"""Times that jitter, are rounded, lack rows or have gaps become samples of one period."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.time_axis import restarts, time_axis

PERIOD_S = 1e-3


def place(row):
    return f"data.csv, row {row + 2}"


def read(tmp_path, time_s, voltage_v, displacement_um, digits=9):
    path = tmp_path / "data.csv"
    np.savetxt(path, np.column_stack([time_s, voltage_v, displacement_um]), delimiter=",",
               fmt=[f"%.{digits}f", "%.9g", "%.9g"], header="time_s,voltage_v,displacement_um",
               comments="")
    return read_recording(path)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000), jitter=st.floats(0.12, 0.3), start_s=st.floats(-1e3, 1e3))
def test_jitter_is_resampled_as_well_as_a_straight_line_can(seed, jitter, start_s):
    random = np.random.default_rng(seed)
    rows = 500
    time_s = start_s + PERIOD_S * (np.arange(rows) + jitter * random.uniform(-1, 1, rows))
    axis = time_axis(time_s, place, "time_s")
    assert axis.period_s == pytest.approx(PERIOD_S, rel=3e-4)
    assert "resampled" in axis.notes[0]
    assert axis.jitter_s == pytest.approx(jitter * PERIOD_S / np.sqrt(3.0), rel=0.2)

    def signal(at_s):
        return np.sin(2 * np.pi * 10.0 * (at_s - start_s))

    sampled = np.interp(axis.at_rows, np.arange(rows), signal(time_s))
    true = signal(time_s[0] + axis.period_s * axis.sample_index)
    # Of a straight line over at most 1.6 periods.
    bound = (2 * np.pi * 10.0 * 1.6 * PERIOD_S) ** 2 / 8.0
    assert np.abs(sampled - true).max() < bound


@pytest.mark.parametrize("period_s, digits", [(4e-4, 3), (1.5e-3, 3), (2.5e-5, 4)])
def test_rounded_times_keep_the_rows_and_their_period(period_s, digits):
    time_s = np.round(period_s * np.arange(5000), digits)
    axis = time_axis(time_s, place, "time_s")
    assert axis.at_rows is None
    assert axis.period_s == pytest.approx(period_s, rel=1e-3)
    np.testing.assert_array_equal(axis.sample_index, np.arange(5000))


@settings(deadline=None, max_examples=30)
@given(gaps=st.lists(st.tuples(st.integers(50, 950), st.floats(5.0, 500.0)), min_size=1,
                     max_size=4, unique_by=lambda gap: gap[0]))
def test_gaps_become_segments_of_the_rows_as_they_are(gaps):
    time_s = PERIOD_S * np.arange(1000)
    for row, periods in gaps:
        time_s[row:] += periods * PERIOD_S
    axis = time_axis(time_s, place, "time_s")
    assert axis.at_rows is None
    assert axis.period_s == pytest.approx(PERIOD_S, rel=1e-6)
    breaks = np.flatnonzero(np.diff(axis.sample_index) > 1) + 1
    assert breaks.tolist() == sorted(row for row, _ in gaps)
    np.testing.assert_allclose(axis.sample_index * PERIOD_S, time_s, atol=2.1 * PERIOD_S)


def test_gaps_of_a_file_are_said_and_give_segments(tmp_path):
    kept = np.r_[0:300, 420:900, 1000:1200]
    recording = read(tmp_path, 5.0 + PERIOD_S * kept, np.sin(kept / 50.0), kept / 100.0)
    assert recording.gaps == [(300, 120), (900, 100)]
    assert [len(part.voltage_v) for part in recording.segments] == [300, 480, 200]
    assert [part.gaps for part in recording.segments] == [[], [], []]
    np.testing.assert_allclose(recording.segments[1].displacement_um, kept[300:780] / 100.0)
    assert any("2 gaps, the first of 0.121 s before row 302" in note for note in recording.notes)


def test_rows_that_were_lost_one_by_one_are_put_in(tmp_path):
    kept = np.delete(np.arange(2000), [100, 101, 500, 1500])
    recording = read(tmp_path, PERIOD_S * kept, kept * 0.05, kept * 0.01)
    np.testing.assert_allclose(recording.displacement_um, 0.01 * np.arange(2000), atol=1e-9)
    assert recording.gaps == []
    assert any("4 rows are missing" in note for note in recording.notes)


def test_the_rows_beside_one_that_was_put_in_stay_as_they_are(tmp_path):
    """To the last digit: a converter's values are few."""
    values = 0.0244 * (np.arange(4000) * 37 % 11)
    rows = np.delete(np.arange(4000), 1700)
    path = tmp_path / "lost.csv"
    np.savetxt(path, np.column_stack([1e-4 * rows, values[rows], values[rows]]), "%.9g", ",",
               header="time_s,voltage_v,displacement_um", comments="")
    recording = read_recording(path)
    assert np.unique(recording.displacement_um).size <= 12


@pytest.mark.parametrize("printed", ["%.9g", "%.6f", "%.17g"])
def test_rows_keep_their_voltages_beside_lost_ones_if_their_times_are_rounded(tmp_path, printed):
    rows = np.delete(np.arange(200), [13, 77])
    level_v = np.where(np.arange(200) // 20 % 2, 90.0, 10.0)
    behind_um = np.concatenate([[1.0], 0.1 * level_v[:-1]])
    path = tmp_path / "lost.csv"
    np.savetxt(path, np.column_stack([rows / 30.0, level_v[rows], behind_um[rows]]),
               [printed, "%g", "%g"], ",", header="time_s,voltage_v,displacement_um", comments="")
    recording = read_recording(path)
    np.testing.assert_allclose(recording.voltage_v, level_v)
    np.testing.assert_allclose(recording.displacement_um, behind_um)


def test_a_voltage_that_is_held_is_held_where_it_is_resampled(tmp_path):
    random = np.random.default_rng(1)
    time_s = PERIOD_S * (np.arange(1000) + 0.25 * random.uniform(-1, 1, 1000))
    level_v = np.where(np.arange(1000) // 50 % 2, 80.0, 20.0)
    recording = read(tmp_path, time_s, level_v, level_v * 0.1)
    assert set(recording.voltage_v) == {20.0, 80.0}


@pytest.mark.parametrize("time_s, said", [
    ([0.0, 1, 2, 1, 2, 3], "row 5: time_s steps by -1 s where 1 s.*recording=NAME"),
    ([3.0, 3, 3, 3], "steps by 0 s in every row"),
    (np.cumsum(np.random.default_rng(2).pareto(0.5, 1000) + 0.01), "has no sample period"),
])
def test_time_that_makes_no_sense_is_refused_with_its_row(time_s, said):
    with pytest.raises(RecordingError, match=said):
        time_axis(np.array(time_s, dtype=float), place, "time_s")


def test_time_that_begins_anew_is_told_from_one_that_falls():
    once = np.arange(5.0)
    assert restarts(np.concatenate([once, once, once])) == [5, 10]
    assert restarts(np.concatenate([once, once + 2.0])) == []
    assert restarts(once) == []
