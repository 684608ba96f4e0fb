# SPDX-License-Identifier: BSD-3-Clause
"""Mains hum in recordings of a stage that shares no code with the models."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.identification.identify import identify
from piezo_identification.identification.recorded_hum import hum_of
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.cascade import StageModel
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

FAST_S, SLOW_S = 5e-4, 4e-3
MODE_HZ, DAMPING, GAIN_UM_PER_V = 170.0, 0.2, 5.0
NOISE_UM, HUM_UM, MAINS_HZ = 0.005, 0.015, 50.02


def stage_um(voltage_v, sample_period_s, width_v=0.0):
    """Play of some width and a mode, as a recursion of order two: a mode of held voltages."""
    played_v, state = np.zeros(voltage_v.size), voltage_v[0]
    for n, voltage in enumerate(voltage_v):
        state = min(max(state, voltage - width_v), voltage + width_v)
        played_v[n] = 0.8 * voltage + 0.2 * state
    pole = 2.0 * np.pi * MODE_HZ * (-DAMPING + 1j * np.sqrt(1.0 - DAMPING**2)) * sample_period_s
    decay, moved_v, ringing = np.exp(pole), np.zeros(voltage_v.size), 0j
    # The mode is the imaginary part of a complex first-order system, scaled to a unit gain.
    scale = np.imag(-1.0 / pole)
    for n, voltage in enumerate(played_v - played_v[0]):
        moved_v[n] = ringing.imag / scale
        ringing = decay * ringing + (decay - 1.0) / pole * voltage
    return GAIN_UM_PER_V * (moved_v + played_v[0])


def hum_um(size, sample_period_s, seed):
    """A tone with harmonics whose phase drifts."""
    time_s = np.arange(size) * sample_period_s
    phase = 2.0 * np.pi * MAINS_HZ * time_s + seed + 0.2 * np.sin(2.0 * time_s / time_s[-1])
    return HUM_UM * (np.sin(phase) + 0.3 * np.sin(2.0 * phase + 1.0) + 0.3 * np.sin(3.0 * phase))


def recorded(voltage_v, sample_period_s, seed, hums, width_v=0.0):
    noise_um = NOISE_UM * np.random.default_rng(seed).normal(size=voltage_v.size)
    return recording_of({
        "time_s": np.arange(voltage_v.size) * sample_period_s, "voltage_v": voltage_v,
        "displacement_um": stage_um(voltage_v, sample_period_s, width_v) + noise_um
        + hums * hum_um(voltage_v.size, sample_period_s, seed)})


def multisine_v(period, repeats, seed=3):
    """Lines of 1 to 400 Hz, of random phase, between -6 and 6 V."""
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[1 : round(400.0 * period * FAST_S)] = 1.0
    spectrum *= np.exp(2j * np.pi * np.random.default_rng(seed).random(spectrum.size))
    wave = np.fft.irfft(spectrum, period)
    return np.tile(6.0 * wave / np.abs(wave).max(), repeats)


def loops_v():
    time_s = np.arange(round(12.0 / SLOW_S)) * SLOW_S
    return -8.0 * np.cos(2.0 * np.pi * time_s / 2.0) * (1.0 - time_s / 13.0)


def model(*effects):
    return StageModel(
        PreisachModel.line(-10.0, 10.0, GAIN_UM_PER_V), CreepDynamics(),
        ElectricVibrationDynamics(0.0, (2.0 * np.pi * MODE_HZ,), (DAMPING,)), effects=effects)


HUMMING_MODE = CoupledMode(2.0 * np.pi * 50.03, 0.0016, 1e-4, 1e-4)


@pytest.mark.parametrize("effects", [(), (HUMMING_MODE,)], ids=["no mode", "a mode of 50 Hz"])
@pytest.mark.parametrize(("voltage_v", "sample_period_s"), [
    (multisine_v(2000, 6), FAST_S), (loops_v(), SLOW_S)], ids=["multisine", "loops"])
def test_hum_is_found_whether_or_not_a_mode_describes_it(voltage_v, sample_period_s, effects):
    data = recorded(voltage_v, sample_period_s, 1, True)
    hum = hum_of(simulated_recording(model(*effects), data))
    true_um = hum_um(voltage_v.size, sample_period_s, 1)
    assert hum.frequency_hz == pytest.approx(MAINS_HZ, abs=0.06)
    assert np.std(hum.signal_um - true_um) < 0.2 * np.std(true_um)


def test_a_smooth_recording_without_hum_has_none():
    data = recorded(multisine_v(2000, 6), FAST_S, 1, False)
    assert hum_of(simulated_recording(model(), data)) is None


WAVES = {"sine": np.sin, "square": lambda phase: np.sign(np.sin(phase) + 1e-9),
         "triangle": lambda phase: np.arcsin(np.sin(phase))}
AT_EACH_WAVE = [("sine", 50.0), ("square", 12.5), ("triangle", 2.0)]


@pytest.mark.parametrize(("wave", "drive_hz"), [
    *AT_EACH_WAVE, *(pytest.param(*each, marks=pytest.mark.long) for each in product(
        WAVES, (50.0, 25.0, 12.5, 10.0, 5.0, 2.0)) if each not in AT_EACH_WAVE)])
def test_harmonics_that_an_unmodelled_hysteresis_makes_of_the_voltage_are_no_hum(wave, drive_hz):
    time_s = np.arange(16_000) * FAST_S
    voltage_v = 4.0 * WAVES[wave](2.0 * np.pi * drive_hz * time_s)
    data = recorded(voltage_v, FAST_S, 1, False, 2.0)
    assert hum_of(simulated_recording(model(), data)) is None


@pytest.mark.parametrize("drive_hz", [
    25.0, *(pytest.param(hertz, marks=pytest.mark.long) for hertz in (12.5, 10.0, 5.0, 2.5))])
def test_harmonics_of_square_waves_whose_steps_up_and_down_differ_are_no_hum(drive_hz):
    rows = round(1.0 / (drive_hz * FAST_S))
    voltage_v = np.where(np.arange(16_000) % rows < rows // 2, 4.0, -4.0)
    behind_a_lag_v = lfilter([0.4], [1.0, -0.6], voltage_v)
    data = recorded(voltage_v, FAST_S, 1, False)
    curved_um = 0.02 * behind_a_lag_v**2
    assert hum_of(simulated_recording(model(), replace(
        data, displacement_um=data.displacement_um + curved_um))) is None


@pytest.mark.long
def test_hum_becomes_no_mode_of_the_model_and_is_reported():
    notes = []
    identified = identify(dynamics=recorded(multisine_v(2000, 6), FAST_S, 1, True),
                          hysteresis=recorded(loops_v(), SLOW_S, 2, True), note=notes.append)
    told = [note for note in notes if "hum of" in note]
    assert [note.split(":")[0] for note in told] == ["dynamics", "hysteresis"]
    assert all("at 50.0" in note or "at 49.9" in note for note in told)
    found = identified.model
    assert not found.effects
    assert found.dynamics.mode_frequencies_rad_per_s == pytest.approx(
        (2.0 * np.pi * MODE_HZ,), rel=1e-3)
    assert found.dynamics.damping_ratios == pytest.approx((DAMPING,), rel=5e-3)
    assert {part["verdict"] for part in identified.adequacy.values()} == {"adequate"}
