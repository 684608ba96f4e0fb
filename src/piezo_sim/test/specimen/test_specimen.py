# SPDX-License-Identifier: BSD-3-Clause
"""A specimen under the tip: what the detectors measure is that of the true position."""

import numpy as np
import pytest

from piezo_common.gsf import Field, read_gsf
from piezo_sim.simulated_stage import SimulatedStage
from piezo_sim.specimen.grating import DEPTH_UM, grating
from piezo_sim.specimen.specimen import HEIGHT_NOISE_UM, Specimen
from piezo_sim.specimen.specimen_command import main

ALONG_UM = (np.arange(60) + 0.5) * 0.5 - 5.0
SLOPE = Field(0.02 * ALONG_UM + 0.01 * ALONG_UM[:, None], (-5.0, -5.0), (30.0, 30.0), "um")


def voltages(samples):
    phase = 2.0 * np.pi * np.arange(samples) / 4000.0
    return np.column_stack([30.0 - 30.0 * np.cos(phase), 20.0 * np.sin(phase)])


def test_height_is_that_at_the_true_position_of_the_same_sample():
    stage = SimulatedStage("xy", 3, specimen=SLOPE)
    stage.open()
    assert stage.signals == ("height_um", "camera")
    stage.exchange(voltages(8000))
    true_um = stage.true_displacement_um
    height_um = stage.read_signals()[:, 0]
    left_um = height_um - true_um @ [0.02, 0.01]
    assert np.std(left_um) == pytest.approx(HEIGHT_NOISE_UM, rel=0.1)
    assert abs(left_um.mean()) < 1e-5 and np.ptp(height_um) > 0.2


def test_signals_are_the_same_to_the_bit_however_the_samples_are_divided():
    found = []
    for parts in (1, 20):
        stage = SimulatedStage("xy", 3, specimen=SLOPE)
        stage.open()
        taken = []
        for part in np.split(voltages(4000), parts):
            stage.exchange(part)
            taken.append(stage.read_signals())
        found.append(np.concatenate(taken))
    assert np.array_equal(*found)


def test_marks_are_at_the_lines_in_their_exchange_alone():
    stage = SimulatedStage("xy")
    stage.open()
    stage.put_out_marks(np.array([1, 0, 2], np.uint8))
    stage.exchange(voltages(3))
    assert stage.marks.tolist() == [1, 0, 2]
    stage.exchange(voltages(3))
    assert not stage.marks.size


def test_camera_sees_the_slopes_and_the_edge_goes_on_outside():
    specimen = Specimen(SLOPE, 1)
    height_um, brightness = specimen.measured(np.full((2000, 2), [100.0, 0.0])).T
    assert height_um.mean() == pytest.approx(0.02 * ALONG_UM[-1], abs=1e-4)
    level = Specimen(Field(np.zeros((9, 9)), (0.0, 0.0), (9.0, 9.0), "um"), 1)
    assert brightness.mean() - level.measured(np.ones((2000, 2)))[:, 1].mean() == pytest.approx(
        0.5 * 0.03 / np.sqrt(2.0), abs=1e-3)


def test_grating_has_pits_of_its_pitch_and_is_written_by_the_command(tmp_path, capsys):
    field = grating((20.0, 10.0), 25.0, 2.5, 1)
    assert field.corner_um == (7.5, -2.5) and field.values.shape == (500, 500)
    rows = field.values - field.values.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(rows, axis=1)).mean(axis=0)
    assert np.argmax(spectrum) == 10 and -1.1 * DEPTH_UM < field.values.min() < -0.9 * DEPTH_UM
    assert main(["--centre-um", "20", "10", "--size-um", "25", "--output",
                 str(tmp_path / "grating.gsf")]) == 0
    np.testing.assert_allclose(read_gsf(tmp_path / "grating.gsf").values, field.values, atol=1e-7)
    assert "specimen:=" in capsys.readouterr().out
    assert main(["--pitch-um", "0", "--output", str(tmp_path / "none.gsf")]) == 2


def test_stage_of_one_axis_has_no_specimen():
    with pytest.raises(ValueError, match="a specimen lies under two"):
        SimulatedStage(specimen=SLOPE)
