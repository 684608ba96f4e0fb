# SPDX-License-Identifier: BSD-3-Clause
import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_controller.references.reference import (
    InvalidReference,
    Reference,
    is_periodic,
    sample_reference,
    trajectory,
)


@given(st.integers(1, 19999), st.floats(0.1, 50), st.floats(-4, 4))
def test_repeated_harmonic_is_the_sine_of_the_formula(frequency_hz, amplitude_um, phase_rad):
    period_um = sample_reference(
        Reference("harmonic", (frequency_hz,), (amplitude_um,), (phase_rad,), 50.0))
    assert 40000 % len(period_um) == 0
    time_s = np.arange(1000, 1000 + 3 * len(period_um)) / 40000
    expected_um = 50 + amplitude_um / 2 * np.sin(2 * np.pi * frequency_hz * time_s + phase_rad)
    played_um = period_um[np.arange(1000, 1000 + 3 * len(period_um)) % len(period_um)]
    np.testing.assert_allclose(played_um, expected_um, atol=1e-7)


def test_frequency_that_is_no_divisor_of_the_sample_rate_gets_several_cycles():
    assert len(sample_reference(Reference("harmonic", (1500.0,), (1.0,)))) == 80


def test_multi_frequency_is_the_sum_over_the_common_period():
    period_um = sample_reference(
        Reference("multi_frequency", (100.0, 300.0, 400.0), (24.0, 12.0, 12.0), (), 16.2))
    time_s = np.arange(400) / 40000
    expected_um = 16.2 + sum(a * np.sin(2 * np.pi * f * time_s)
                             for f, a in ((100, 12), (300, 6), (400, 6)))
    np.testing.assert_allclose(period_um, expected_um, atol=1e-9)


def test_triangle_has_its_amplitude_and_straight_flanks():
    period_um = sample_reference(Reference("triangle", (10.0,), (40.0,), (), 50.0))
    assert np.ptp(period_um) == pytest.approx(40)
    ideal_um = 50 + 20 * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * np.arange(4000) / 4000))
    assert np.abs(period_um - ideal_um).max() < 0.01 * 40


def test_file_is_taken_as_it_is_about_the_centre(tmp_path):
    path = tmp_path / "reference.csv"
    displacement_um = np.sin(np.arange(80) * 2 * np.pi / 80)
    rows = [f"{n / 40000!r},{y!r}" for n, y in enumerate(displacement_um.tolist())]
    path.write_text("\n".join(["time_s,displacement_um", *rows]) + "\n")
    period_um = sample_reference(Reference("file", centre_um=50.0, file=str(path)))
    np.testing.assert_allclose(period_um, 50 + displacement_um, rtol=1e-15)


@pytest.mark.parametrize("frequency_hz", [33.37, 99.99999, 0.003])
def test_frequency_without_whole_period_is_refused_and_the_nearest_named_is_accepted(frequency_hz):
    with pytest.raises(InvalidReference, match="the nearest that has is") as refusal:
        sample_reference(Reference("harmonic", (frequency_hz,), (1.0,)))
    nearest_hz = float(str(refusal.value).split()[-2])
    assert nearest_hz == pytest.approx(frequency_hz, abs=0.05)
    assert len(sample_reference(Reference("harmonic", (nearest_hz,), (1.0,)))) <= 800000


@pytest.mark.parametrize("reference, message", [
    (Reference("sawtooth", (1.0,), (1.0,)), "unknown kind"),
    (Reference("harmonic", (100.0,), (0.0,)), "not a positive number"),
    (Reference("harmonic", (100.0,), (-1.0,)), "not a positive number"),
    (Reference("harmonic", (100.0,), (float("nan"),)), "not a positive number"),
    (Reference("harmonic", (float("nan"),), (1.0,)), "not between 0.001 Hz and half"),
    (Reference("harmonic", (20000.0,), (1.0,)), "not between 0.001 Hz and half"),
    (Reference("harmonic", (100.0,), (1.0,), (float("inf"),)), "phase_rad"),
    (Reference("harmonic", (100.0,), (1.0,), (), float("nan")), "centre_um"),
    (Reference("harmonic", (), ()), "0 frequencies"),
    (Reference("harmonic", (1.0, 2.0), (1.0, 1.0)), "has one frequency"),
    (Reference("multi_frequency", (1.0, 2.0), (1.0,)), "2 frequencies, 1 amplitudes"),
    (Reference("multi_frequency", (40000 / 641, 0.05), (1.0, 1.0)), "common period"),
    (Reference("file", file="/nowhere.csv"), "cannot be read"),
])
def test_meaningless_reference_is_refused_in_one_sentence(reference, message):
    with pytest.raises(InvalidReference, match=message) as refusal:
        sample_reference(reference)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text, message", [
    ("time,displacement\n0,1\n", "header"),
    ("time_s,displacement_um\n0,1\n0.000025,x\n", "not two numbers"),
    ("time_s,displacement_um\n0,1,2\n0.000025,1,2\n", "not two numbers"),
    ("time_s,displacement_um\n0,1\n0.000025\n", "not two numbers"),
    ("time_s,displacement_um\n0,1\n0.000025,nan\n", "not finite"),
    ("time_s,displacement_um\n0,1\n0.001,1\n", "not sampled at"),
    ("time_s,displacement_um\n0,1\n", "1 samples"),
    ("time_s,displacement_um\n", "0 samples"),
])
def test_unusable_reference_file_is_refused_in_one_sentence(tmp_path, text, message):
    path = tmp_path / "reference.csv"
    path.write_text(text)
    with pytest.raises(InvalidReference, match=message):
        sample_reference(Reference("file", file=str(path)))


@pytest.mark.parametrize("reference", [
    Reference("harmonic", (1500.0,), (1.0,), (0.3,), 50.0),
    Reference("multi_frequency", (100.0, 300.0), (2.0, 1.0), (0.0, 1.0)),
    Reference("triangle", (10.0,), (40.0,), (), 50.0),
    Reference("raster", (100.0,), (20.0,), (), 50.0),
    Reference("raster", (1000.0,), (20.0,), (), 50.0, axis="slow", lines=16),
])
def test_trajectory_of_a_periodic_reference_is_its_period_repeated_before_the_start_too(reference):
    period_um = sample_reference(reference)
    assert is_periodic(reference)
    np.testing.assert_allclose(trajectory(reference).sample(-500, 6500),
                               period_um[np.arange(-500, 6000) % period_um.size], atol=1e-9)


def test_slow_harmonic_has_no_period_to_upload_but_a_trajectory():
    reference = Reference("harmonic", (0.01,), (40.0,), (), 50.0)
    assert not is_periodic(reference)
    trajectory_um = trajectory(reference).sample(0, 1_000_001)
    assert trajectory_um[-1] == pytest.approx(70.0)
    assert trajectory_um[0] == 50.0


def test_random_reference_keeps_its_band_and_its_amplitude():
    reference = Reference("random", (50.0, 800.0), (30.0,), (), 50.0, seed=5)
    assert not is_periodic(reference)
    trajectory_um = trajectory(reference).sample(-4000, 404_000)
    assert np.abs(trajectory_um - 50.0).max() <= 15.0
    assert np.ptp(trajectory_um) > 0.9 * 30.0
    power = np.abs(np.fft.rfft(np.hanning(trajectory_um.size) * (trajectory_um - 50.0))) ** 2
    frequency_hz = np.fft.rfftfreq(trajectory_um.size, 25e-6)
    inside = (frequency_hz >= 50.0) & (frequency_hz <= 800.0)
    assert power[~inside].sum() < 1e-8 * power.sum()
    parts = [power[(frequency_hz > low) & (frequency_hz < low + 100.0)].sum()
             for low in range(100, 700, 100)]
    assert max(parts) < 1.5 * min(parts)
    other = trajectory(dataclasses.replace(reference, seed=6)).sample(0, 400_000)
    assert abs(np.corrcoef(other, trajectory_um[4000:])[0, 1]) < 0.1


def test_random_reference_has_no_period():
    one = trajectory(Reference("random", (500.0,), (30.0,), (), 0.0, seed=2))
    pieces = [one.sample(minute * 2_400_000, 40_000) for minute in range(20)]
    correlated = np.corrcoef(pieces) - np.eye(20)
    assert np.abs(correlated).max() < 0.2
    assert np.std([np.std(piece) for piece in pieces]) < 0.15 * np.std(pieces)


def test_raster_line_is_straight_over_the_range_and_smooth_where_it_turns():
    line_um = sample_reference(Reference("raster", (100.0,), (20.0,), (), 50.0))
    assert line_um.size == 400
    forward = np.diff(line_um[:81])  # from the middle to a fifth of the line's period further
    np.testing.assert_allclose(forward, 20.0 / (400 * 0.4), rtol=1e-9)
    assert line_um[80] == pytest.approx(60.0)  # the end of the range
    assert np.ptp(line_um) > 20.0
    assert np.abs(np.diff(line_um, 2)).max() < 0.1 * forward[0]


def test_slow_axis_rests_on_each_line_while_the_fast_axis_goes_forward():
    fast_um = sample_reference(Reference("raster", (100.0,), (20.0,)))
    frame_um = sample_reference(Reference("raster", (100.0,), (30.0,), axis="slow", lines=512))
    assert frame_um.size == 400 * (512 + 26)
    assert (frame_um.min(), frame_um.max()) == (-15.0, 15.0)
    forward = np.r_[fast_um[1:], fast_um[0]] > fast_um
    drawn = 400 * 511 + 100  # the end of the last line: a frame begins in the middle of one
    lines_um = np.unique(np.round(frame_um[:drawn][np.resize(forward, drawn)], 9))
    np.testing.assert_allclose(lines_um, np.linspace(-15.0, 15.0, 512), atol=1e-9)
    assert np.abs(np.diff(np.r_[frame_um, frame_um[0]])).max() < 0.01


def test_file_played_once_holds_its_ends(tmp_path):
    path = tmp_path / "way.csv"
    rows = [f"{n / 40000!r},{n / 100!r}" for n in range(100)]
    path.write_text("\n".join(["time_s,displacement_um", *rows]) + "\n")
    reference = Reference("file", centre_um=50.0, file=str(path), once=True)
    assert not is_periodic(reference)
    trajectory_um = trajectory(reference).sample(-10, 160)
    np.testing.assert_allclose(
        trajectory_um, 50.0 + np.clip(np.arange(-10, 150), 0, 99) / 100)
    with pytest.raises(InvalidReference, match="has no period"):
        sample_reference(reference)


@pytest.mark.parametrize("reference, message", [
    (Reference("raster", (33.3,), (1.0,)), "the nearest that has is 33.305"),
    (Reference("raster", (100.0,), (1.0,), axis="x"), "unknown axis 'x'"),
    (Reference("raster", (100.0,), (1.0,), axis="slow", lines=1), "1 lines: give at least 2"),
    (Reference("random", (), (1.0,)), "one or two frequencies"),
    (Reference("random", (300.0, 200.0), (1.0,)), "the band from 300 to 200 Hz"),
    (Reference("random", (10.0, 10.0005), (1.0,)), "narrower than 0.001 Hz: use a harmonic"),
    (Reference("random", (300.0,), (0.0,)), "not a positive number"),
    (Reference("random", (300.0,), (1.0,), seed=-1), "seed -1 is negative"),
])
def test_trajectory_without_meaning_is_refused_in_one_sentence(reference, message):
    with pytest.raises(InvalidReference, match=message) as refusal:
        trajectory(reference)
    assert "\n" not in str(refusal.value)
