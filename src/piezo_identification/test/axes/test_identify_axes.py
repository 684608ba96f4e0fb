# SPDX-License-Identifier: BSD-3-Clause
"""Identification of a flexure of two axes, from recordings that begin at rest."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_common.budget import Budget
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_recorder.reading.recording import RecordingError

sys.path.insert(0, str(Path(__file__).parent))
import flexure


@pytest.fixture(scope="module")
def recordings():
    return [flexure.recording(columns, f"experiment {number}")
            for number, columns in enumerate(flexure.experiments(2048), start=1)]


@pytest.fixture(scope="module")
def identified(recordings):
    return identify_several_axes(recordings)


def test_unseen_motion_is_predicted_to_three_times_the_noise(identified):
    rng = np.random.default_rng(9)
    time_s = flexure.PERIOD_S * np.arange(6000)
    triangle_v = 8.0 * np.abs((40.0 * time_s + 0.5) % 2.0 - 1.0) - 4.0
    slow_v = np.linspace(0.0, 6.0, time_s.size)
    unseen = flexure.recording(flexure.table(np.column_stack([triangle_v, slow_v]), rng), "raster")
    prediction = predict_several_axes(identified.model, unseen)
    left = prediction.measured_um - prediction.simulated_um
    assert np.all(np.std(left, axis=0) < 3.0 * flexure.NOISE_UM)


def test_a_recording_that_begins_in_motion_is_predicted_as_well(identified):
    rng = np.random.default_rng(11)
    whole = flexure.recording(flexure.table(rng.normal(size=(4000, 2)), rng), "noise")
    begun = replace(whole, voltage_v=whole.voltage_v[1777:],
                    displacement_um=whole.displacement_um[1777:])
    prediction = predict_several_axes(identified.model, begun)
    left = prediction.measured_um - prediction.simulated_um
    assert np.all(np.std(left, axis=0) < 1.5 * flexure.NOISE_UM)


def test_modes_are_found(identified):
    poles = identified.model.poles_rad_per_s
    for frequency, damping in zip(flexure.FREQUENCY_RAD_PER_S, flexure.DAMPING, strict=True):
        nearest = np.argmin(np.abs(np.abs(poles) - frequency))
        off = identified.pole_deviations_rad_per_s[nearest]
        true = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
        error = poles[nearest] - true
        assert abs(error.real) < 4.0 * off.real
        assert abs(error.imag) < 4.0 * off.imag
        assert off.imag < 3e-5 * frequency, "as the noise allows"


def test_modes_that_are_closer_than_their_width_are_found(monkeypatch):
    frequencies = 2.0 * np.pi * np.array([434.2, 436.4, 720.0])
    monkeypatch.setattr(flexure, "FREQUENCY_RAD_PER_S", frequencies)
    monkeypatch.setattr(flexure, "DAMPING", np.array([0.0077, 0.0033, 0.02]))
    poles = identify_several_axes([
        flexure.recording(columns, f"experiment {number}")
        for number, columns in enumerate(flexure.experiments(1024))]).model.poles_rad_per_s
    light = np.sort(np.abs(poles[-poles.real < 0.05 * np.abs(poles)]))
    np.testing.assert_allclose(light, frequencies, rtol=1e-3)


def test_every_entry_of_the_coupling_is_within_its_interval(identified):
    coupling = identified.coupling
    driven = coupling.frequency_hz < 2500.0
    true = flexure.response(coupling.frequency_hz)[driven]
    low, high = (each[driven] for each in coupling.interval_90())
    within = [(low.real <= true.real) & (true.real <= high.real),
              (low.imag <= true.imag) & (true.imag <= high.imag)]
    for row in range(2):
        for column in range(2):
            held = np.mean([each[:, row, column] for each in within])
            assert held > 0.75, f"{row}{column}: {held:.2f}"
    half = 1.6449 * np.abs(coupling.deviation_um_per_v[driven])
    error = np.abs(coupling.gain_um_per_v[driven] - true)
    assert np.all(error < np.maximum(0.1 * np.abs(true), 3.0 * half))


def test_delays_of_the_sensors_are_found(identified):
    wanted_s = np.array(flexure.LATE) * flexure.PERIOD_S
    assert np.all(np.abs(identified.delays_s - wanted_s) < 4.0 * identified.delay_deviations_s)
    assert np.all(identified.delay_deviations_s < 0.2 * flexure.PERIOD_S)


def test_a_slow_amplifier_is_a_pole_and_no_delay_of_the_sensor():
    kept = np.exp(-0.1)
    rng, tables = np.random.default_rng(3), []
    for axis in range(2):
        voltage_v = flexure.multisine_v(2048, rng)[:, None] * np.eye(2)[axis]
        slower_v = lfilter([0.0, 1.0 - kept], [1.0, -kept], voltage_v, axis=0)
        columns = flexure.table(slower_v, rng)
        columns |= {"x_voltage_v": voltage_v[:, 0], "y_voltage_v": voltage_v[:, 1]}
        tables.append(flexure.recording(columns, f"experiment {axis}"))
    model = identify_several_axes(tables, pairs=4).model
    assert np.max(model.latency_samples) <= 2
    np.testing.assert_allclose(np.diag(model.response(0.0)[0].real),
                               np.diag(flexure.response([0.0])[0].real), rtol=2e-3)


def test_a_budget_ends_the_search_with_the_best_so_far(recordings):
    found = identify_several_axes(recordings, budget=Budget(1e-3))
    assert "not tried: more than 4 poles" in found.unfinished
    assert "further refinement" in found.unfinished
    assert found.model.poles_rad_per_s.size


def test_an_axis_that_rests_throughout_is_refused(recordings):
    with pytest.raises(RecordingError, match="no recording moves the axis y"):
        identify_several_axes(recordings[:1])


def test_recordings_of_other_axes_are_refused(recordings):
    columns = flexure.experiments(samples=512)[0]
    renamed = {name.replace("y_", "z_"): values for name, values in columns.items()}
    with pytest.raises(RecordingError, match="give those of one stage"):
        identify_several_axes([*recordings, flexure.recording(renamed, "other")])
