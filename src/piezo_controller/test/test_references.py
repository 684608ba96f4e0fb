# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_controller.references import InvalidReference, Reference, sample_reference


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
    (Reference("harmonic", (float("nan"),), (1.0,)), "not between 0 and half"),
    (Reference("harmonic", (20000.0,), (1.0,)), "not between 0 and half"),
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
