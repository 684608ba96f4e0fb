# SPDX-License-Identifier: BSD-3-Clause
"""A recording is shown in a line, a table and a picture that is no solid block."""

import numpy as np
import pytest

from piezo_recorder.reading.memory import recording_of
from piezo_recorder.reading.recording_view import SHOWN_PERIODS, close_look


def square_wave(periods, samples=400):
    voltage_v = np.tile(np.repeat([20.0, 80.0], samples // 2), periods)
    return recording_of({"time_s": 25e-6 * np.arange(voltage_v.size), "voltage_v": voltage_v,
                         "displacement_um": 0.4 * voltage_v}, name="square wave")


def test_line_is_short_whatever_the_samples():
    text = repr(square_wave(200))
    assert text == ("<Recording square wave: 80000 samples every 2.5e-05 s, 20 to 80 V, "
                    "8 to 32 um>")


def test_table_holds_extent_and_ranges():
    recording = square_wave(10)
    cells = {row[0]: row[1:] for row in recording.summary().rows}
    assert cells["samples"][0] == 4000
    assert cells["duration"][0] == pytest.approx(0.1)
    assert cells["sample rate"][0] == pytest.approx(40_000.0)
    assert cells["voltage"] == (20.0, 80.0, "V")
    assert "<table>" in recording._repr_html_()


@pytest.mark.parametrize("noise_v", [0.0, 2.0])
def test_close_look_holds_a_few_periods_of_a_fast_wave(noise_v):
    voltage_v = square_wave(200).voltage_v
    part = close_look(voltage_v + noise_v * np.random.default_rng(1).normal(size=voltage_v.size))
    assert part.stop - part.start == SHOWN_PERIODS * 400
    assert np.unique(voltage_v[part]).size == 2


def test_slow_and_constant_voltages_are_looked_at_as_a_whole():
    assert close_look(square_wave(5).voltage_v) is None
    assert close_look(np.full(1000, 3.0)) is None


def test_picture_has_the_close_look_beside_the_whole():
    recording = square_wave(200)
    axes = recording.plot().axes
    assert [one.get_title() for one in axes].count("close") == 1
    whole, = (one for one in axes if one.get_title() == "whole")
    line, = whole.lines
    assert line.get_xdata().size <= 4000
    assert {line.get_ydata().min(), line.get_ydata().max()} == {20.0, 80.0}
    assert recording.plot()._repr_png_().startswith(b"\x89PNG")
