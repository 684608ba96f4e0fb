# SPDX-License-Identifier: BSD-3-Clause
"""What no stage does is said when a recording is read; what stages do is not."""

import re

import numpy as np
import pytest

from piezo_recorder.reading.plausibility import clipped_ends
from piezo_recorder.reading.reader import read_recording

INDEX = np.arange(4000)
SINE = 0.5 - 0.5 * np.cos(INDEX / 300.0)
SQUARE = (INDEX // 500 % 2).astype(float)


def notes(tmp_path, voltage_v, displacement_um, rows=None):
    path = tmp_path / "data.csv"
    np.savetxt(path, np.column_stack([1e-3 * INDEX, voltage_v, displacement_um])[:rows],
               delimiter=",", header="time_s,voltage_v,displacement_um", comments="")
    return " ".join(read_recording(path).notes)


@pytest.fixture
def noise_um():
    return np.random.default_rng(4).normal(scale=0.005, size=INDEX.size)


@pytest.mark.parametrize("shape", [SINE, SQUARE])
@pytest.mark.parametrize("swing_v, gain, quantum_um", [
    (150.0, 0.2, 0.0), (1000.0, 0.01, 0.0), (60.0, 10.0, 0.0), (100.0, 0.6, 0.05)])
def test_usual_stage_is_not_objected_to(tmp_path, noise_um, shape, swing_v, gain, quantum_um):
    displacement_um = gain * swing_v * shape + noise_um
    if quantum_um:
        displacement_um = quantum_um * np.round(displacement_um / quantum_um)
    assert notes(tmp_path, swing_v * shape - 20.0, displacement_um) == ""


def test_noiseless_simulation_is_not_taken_for_clipped(tmp_path):
    assert notes(tmp_path, 100.0 * SQUARE, 20.0 * SQUARE) == ""
    assert notes(tmp_path, 100.0 * SINE, 20.0 * SINE) == ""


@pytest.mark.parametrize("voltage_v, displacement_um, said", [
    (100.0 * SINE, 0.1 * SINE, "changes by 0.1 um only"),
    (1e5 * SINE, 30.0 * SINE, "reaches 1e\\+05 V"),
    (0.1 * SINE, 30.0 * SINE, "in kV, or before the amplifier"),
    (100.0 * SINE, 30_000.0 * SINE, "is it in nm"),
    (900.0 * SINE, 0.9 * SINE, "unit wrong by 1000"),
    (100.0 + 0.0 * SINE, 30.0 * SINE, "the voltage is 100 V throughout"),
    (100.0 * SINE, 30.0 + 0.0 * SINE, "is the sensor on"),
])
def test_implausible_numbers_are_said(tmp_path, voltage_v, displacement_um, said):
    assert re.search(said, notes(tmp_path, voltage_v, displacement_um))


def test_a_resonance_is_no_wrong_unit(tmp_path):
    """Tones through a mode move the stage thirty times as far as the same voltage at rest."""
    w, damping = 60.0, 0.015
    rates = np.repeat(np.linspace(20.0, 180.0, 9), 444)[: INDEX.size - 4]
    rates = np.append(rates, np.full(INDEX.size - rates.size, 180.0))
    phase = np.cumsum(rates * 1e-3)
    gain = 6.0 / (1.0 - (rates / w) ** 2 + 2j * damping * rates / w)
    moved_um = np.real(gain * np.exp(1j * phase))
    assert np.ptp(moved_um) / 2.0 > 100.0
    assert "unit" not in notes(tmp_path, np.cos(phase), moved_um)
    assert "unit wrong by 1000" in notes(tmp_path, np.cos(phase), 60.0 * np.cos(phase))


def test_columns_that_are_exchanged_are_asked_about(tmp_path, noise_um):
    late = 0.5 - 0.5 * np.cos(INDEX / 300.0 - 0.12)  # as hysteresis, creep and lags make it
    assert notes(tmp_path, 100.0 * SINE, 13.0 * late + noise_um) == ""
    said = notes(tmp_path, 7.0 + 13.0 * late + noise_um, 100.0 * SINE)
    assert said.endswith("are the two columns exchanged?")


def test_few_rows_are_said(tmp_path):
    assert "only 3 rows" in notes(tmp_path, 100.0 * SINE, 10.0 * SINE, rows=3)


@pytest.mark.parametrize("shape", [SINE, SQUARE])
def test_clipped_sensor_is_said_with_its_end(tmp_path, noise_um, shape):
    displacement_um = 20.0 * shape + noise_um
    said = notes(tmp_path, 100.0 * shape, np.minimum(displacement_um, 19.99))
    assert "stays at its highest value, 19.99 um" in said
    said = notes(tmp_path, 100.0 * shape, np.maximum(displacement_um, 0.01))
    assert "stays at its lowest value, 0.01 um" in said


def test_the_crest_of_a_sine_is_not_clipped_by_a_converter_where_a_row_was_put_in():
    time_s = 1e-3 * np.arange(6000)
    voltage_v = 50.0 + 45.0 * np.sin(2.0 * np.pi * 1.5 * time_s)
    step_um = 0.0244
    noise_um = 0.1 * step_um * np.random.default_rng(0).normal(size=time_s.size)
    displacement_um = step_um * np.round((0.6 * voltage_v + noise_um) / step_um)
    displacement_um[4000] += 1e-13
    displacement_um[5000] += 0.5 * step_um
    assert not clipped_ends(displacement_um, voltage_v)
