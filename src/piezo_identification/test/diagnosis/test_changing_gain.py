# SPDX-License-Identifier: BSD-3-Clause
"""A gain that changes while it is recorded, by NumPy alone: along the way gone, and in time."""

import numpy as np
import pytest
from made_by_scipy import line_model, logged, smooth_noise_v

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_models.effects.gain_drift import GainDrift

PERIOD_S, SAMPLES, NOISE_UM = 1e-2, 4000, 5e-3
LINE = line_model(gain_um_per_v=0.6)


def recording(gain, offset_um=0.0):
    """Record a line whose gain is a function of time and of the way travelled before."""
    generator = np.random.default_rng(3)
    voltage_v = smooth_noise_v(generator, SAMPLES, 60)
    travelled_v = np.cumsum(np.abs(np.diff(voltage_v, prepend=voltage_v[0])))
    time_s = PERIOD_S * np.arange(SAMPLES)
    displacement_um = 0.6 * voltage_v * gain(time_s, travelled_v / travelled_v[-1]) + offset_um
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um, PERIOD_S)


@pytest.mark.parametrize(("gain", "lost"), [
    (lambda time_s, way: 1.0 - 0.04 * time_s / 40.0, -0.04),
    pytest.param(
        lambda time_s, way: 1.0 - 0.04 * (1.0 - np.exp(-3.0 * way)), -0.04 * (1.0 - np.exp(-3.0)),
        marks=pytest.mark.long),
], ids=["in time", "along the way"])
def test_a_gain_that_changes_is_named_with_its_change(gain, lost):
    diagnosis = diagnose(LINE, [recording(gain, offset_um=4.0)])
    assert [entry["name"] for entry in diagnosis.effects] == ["gain_drift"]
    (effect,) = diagnosis.model.effects
    whole = effect.apply(np.array([0.0, *np.ones(SAMPLES)]), PERIOD_S)[-1]
    unmoved = effect.apply(np.zeros(SAMPLES + 1), PERIOD_S)[-1]
    # The other gain that is found beside it is free.
    assert whole - unmoved - 1.0 == pytest.approx(lost, rel=0.15)
    assert diagnosis.after["rms_um"] < 0.2 * diagnosis.before["rms_um"]


def test_a_drift_of_the_whole_stage_is_no_change_of_its_gain(few_effects):
    drifting = recording(lambda time_s, way: 1.0)
    drifting.displacement_um[:] += 0.02 * PERIOD_S * np.arange(SAMPLES)
    with few_effects("gain_drift", "thermal_drift"):
        diagnosis = diagnose(LINE, [drifting])
    assert "gain_drift" not in [entry["name"] for entry in diagnosis.effects]


def test_in_parts_it_goes_on_where_it_stopped():
    drift = GainDrift(-0.2, 1.5, 3.0)
    signal = np.sin(np.arange(300.0))
    first, past = drift.advance(signal[:77], PERIOD_S)
    np.testing.assert_allclose(
        np.concatenate([first, drift.advance(signal[77:], PERIOD_S, past)[0]]),
        drift.apply(signal, PERIOD_S), rtol=0.0, atol=1e-14)
