# SPDX-License-Identifier: BSD-3-Clause
"""A lag ahead of plays that NumPy alone has made, or behind a mode of SciPy's."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import logged, smooth_noise_v
from scipy.signal import cont2discrete, lfilter

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S, SAMPLES, NOISE_UM, STEPS = 1e-3, 4000, 5e-3, 10
MODE_RAD_PER_S, DAMPING_RATIO = 700.0, 0.1
HIGHEST_V, GAIN_UM_PER_V, DENSITY_UM_PER_V2 = 60.0, 0.4, 2e-3
LAG_S = 5e-3
pytestmark = pytest.mark.usefixtures("without_ceiling")
MODEL = StageModel(
    PreisachModel(-HIGHEST_V, HIGHEST_V, np.tril(np.full((6, 6), DENSITY_UM_PER_V2)), 0.0,
                  np.full(6, GAIN_UM_PER_V)),
    CreepDynamics(), ElectricVibrationDynamics(0.0, (MODE_RAD_PER_S,), (DAMPING_RATIO,)))


def plays_um(voltage_v, count=300):
    """Return a gain and plays of every width, which begin where the voltage is lowest."""
    widths_v = 2.0 * HIGHEST_V * (np.arange(count) + 0.5) / count
    played_v = voltage_v[0] + 0.5 * widths_v
    total_um = GAIN_UM_PER_V * voltage_v
    for n, voltage in enumerate(voltage_v):
        np.clip(played_v, voltage - 0.5 * widths_v, voltage + 0.5 * widths_v, out=played_v)
        total_um[n] += DENSITY_UM_PER_V2 * played_v.mean() * 2.0 * HIGHEST_V
    return total_um


def through(numerator, denominator, signal, method="zoh"):
    discrete = cont2discrete((numerator, denominator), PERIOD_S / STEPS, method)
    return signal[0] + lfilter(np.ravel(discrete[0]), discrete[1], signal - signal[0])


def recording(ahead=lambda voltage_v: voltage_v, behind=lambda displacement_um: displacement_um,
              seed=1, bandwidth_rows=60):
    """Record rows of which each holds its voltage, simulated in parts of them."""
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, bandwidth_rows, 0.9 * HIGHEST_V)
    voltage_v[:50] = np.linspace(-HIGHEST_V, voltage_v[50], 50)
    driving_um = plays_um(ahead(np.repeat(voltage_v, STEPS)))
    w, z = MODE_RAD_PER_S, DAMPING_RATIO
    displacement_um = behind(through([w * w], [1.0, 2.0 * z * w, w * w], driving_um))[::STEPS]
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um, name=f"seed {seed}")


def of_late_voltage(share):
    """Return what makes a share of a held voltage late: of that, its mean over each part."""
    def ahead(voltage_v):
        late_v = through([1.0], [LAG_S, 1.0], voltage_v)
        mean_v = 0.5 * (late_v + np.append(late_v[1:], late_v[-1]))
        return (1.0 - share) * voltage_v + share * mean_v

    return ahead


def names_of(diagnosis):
    return [entry["name"] for entry in diagnosis.effects]


def test_without_a_lag_the_model_lacks_nothing(few_effects):
    with few_effects("amplifier_lag", "voltage_relaxation", "second_order_amplifier"):
        assert diagnose(MODEL, [recording()]).verdict == "none"


@pytest.mark.long
@pytest.mark.parametrize(("share", "name"), [(1.0, "amplifier_lag"), (0.25, "voltage_relaxation")])
def test_a_lag_ahead_of_the_hysteresis_is_named_alone(share, name):
    diagnosis = diagnose(MODEL, [recording(of_late_voltage(share))])
    assert (diagnosis.verdict, names_of(diagnosis)) == ("explained", [name])
    found = diagnosis.effects[0]["parameters"]
    assert found["time_constant_s"] == pytest.approx(LAG_S, rel=0.02)
    assert found.get("share", 1.0) == pytest.approx(share, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(("name", "behind"), [
    ("sensor_lag", lambda signal: through([1.0], [LAG_S, 1.0], signal, "foh")),
    ("delay", lambda signal: np.concatenate([np.full(25, signal[0]), signal[:-25]])),
    ("creep", lambda signal: signal + 0.05 * through(
        [1.0], [0.3, 1.0], signal - signal[0], "foh")),
], ids=["sensor_lag", "delay", "creep"])
def test_what_is_behind_the_hysteresis_is_not_taken_for_a_lag_ahead_of_it(name, behind):
    diagnosis = diagnose(MODEL, [recording(behind=behind)])
    assert diagnosis.verdict == "explained"
    assert names_of(diagnosis)[0] == name
    assert not {"amplifier_lag", "voltage_relaxation"} & {*names_of(diagnosis)}


@pytest.mark.long
@pytest.mark.parametrize(("was_there", "came"), [
    (True, "before the identification"), (False, "after the identification")])
def test_when_a_share_of_the_voltage_became_late(was_there, came):
    """A model that was identified meanwhile has an electric lag of its mean delay instead."""
    ahead = of_late_voltage(0.25)
    model = replace(MODEL, dynamics=replace(
        MODEL.dynamics, time_constant_s=0.25 * LAG_S)) if was_there else MODEL
    old = [recording(*[ahead] * was_there, seed=seed) for seed in (2, 3)]
    diagnosis = diagnose(model, [recording(ahead)],
                         identified_from=IdentificationRecordings(old, ()))
    assert (diagnosis.verdict, names_of(diagnosis)) == ("explained", ["voltage_relaxation"])
    assert diagnosis.effects[0]["came"] == came
    assert diagnosis.effects[0]["parameters"]["share"] == pytest.approx(0.25, rel=0.05)
