# SPDX-License-Identifier: BSD-3-Clause
"""Models compete on recordings that SciPy alone has made: effects there all along, and since."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged, smooth_noise_v

from piezo_identification.diagnosis.comparison.selection import Selection
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.alternatives import _turn_of, settled
from piezo_identification.diagnosis.joint.competition import (
    Competition,
    led_by_the_most_probable,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
)
from piezo_identification.fitting.free_parameters import changed_model, free_sensitivities
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.usefixtures("likely_effects")

SAMPLES, NOISE_UM = 1500, 2e-3
MODE_RAD_PER_S, DAMPING_RATIO = 400.0, 0.1
OTHER_MODE = (250.0, 0.02, 0.02)


def recording(name, seed, measure=lambda displacement_um: displacement_um, other_mode=False):
    """Record a line with a mode or two beside each other, and what the sensor makes of it."""
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, 20)
    modes = [OTHER_MODE] if other_mode else []
    modes.append((MODE_RAD_PER_S, DAMPING_RATIO, 1.0 - sum(part for *_, part in modes)))
    displacement_um = sum(part * behind_mode(0.1 * voltage_v, w, z) for w, z, part in modes)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, measure(displacement_um) + noise_um, name=name)


def curved(displacement_um):
    """Read a displacement with a sensor whose scale is bent by 3 % at its ends."""
    return displacement_um + 0.03 * displacement_um**2 / 10.0


LINE = line_model(MODE_RAD_PER_S, DAMPING_RATIO)


def found(model, new, *old):
    return diagnose(model, [new], identified_from=IdentificationRecordings(old, ()))


@pytest.mark.long
def test_an_effect_that_was_there_all_along_is_told_from_a_bent_model():
    # A model that was identified with the effect in the recordings has a mode that is off.
    bent = replace(LINE, dynamics=ElectricVibrationDynamics(0.0, (380.0,), (0.13,)))
    new, *old = (recording(f"{seed}", seed, curved) for seed in (1, 2, 3))
    diagnosis = found(bent, new, *old)
    assert diagnosis.verdict == "explained"
    first = diagnosis.effects[0]
    assert first["came"] == "before the identification"
    assert first["name"] == "sensor_nonlinearity"
    # A spring changes the mode with the displacement, unless it acts at once.
    assert "acts at once" in diagnosis.not_decidable["stiffening"]
    assert diagnosis.after["rms_um"] < 1.05 * NOISE_UM
    dynamics = diagnosis.model.dynamics
    assert dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(MODE_RAD_PER_S, rel=2e-3)
    assert dynamics.damping_ratios[0] == pytest.approx(DAMPING_RATIO, rel=0.02)
    assert sum(diagnosis.probabilities.values()) == pytest.approx(1.0)
    assert diagnosis.probabilities["sensor_nonlinearity"] > 0.9
    assert diagnosis.document()["identified_from"]["recordings"] == ["2", "3"]


def test_an_effect_that_came_later_is_not_put_into_the_identification():
    new = recording("1", 1, curved)
    diagnosis = found(LINE, new, recording("2", 2), recording("3", 3))
    first = diagnosis.effects[0]
    assert (diagnosis.verdict, first["name"], first["came"]) == (
        "explained", "sensor_nonlinearity", "after the identification")
    assert diagnosis.model.dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(
        MODE_RAD_PER_S, rel=2e-3)


def test_a_model_with_other_parameters_lacks_no_effect():
    bent = replace(LINE, dynamics=ElectricVibrationDynamics(0.0, (380.0,), (0.13,)))
    diagnosis = found(bent, *(recording(f"{seed}", seed) for seed in (1, 2, 3)))
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.probabilities["none"] > 0.9
    assert diagnosis.after["rms_um"] < 1.05 * NOISE_UM < diagnosis.before["rms_um"]
    assert diagnosis.model.dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(
        MODE_RAD_PER_S, rel=2e-3)


def test_free_sensitivities_are_the_derivatives_by_the_free_parameters():
    loops = PreisachModel(-100.0, 100.0, np.tril(np.full((4, 4), 0.5e-4)), -10.0, np.full(4, 0.06))
    model = replace(LINE, hysteresis=loops, creep=CreepDynamics((0.5,), (0.52,)))
    made = recording("1", 1)
    part = simulated_recording(model, made, ())
    rows = np.arange(part.begin, SAMPLES)
    columns = free_sensitivities(part, rows)
    for number in range(columns.shape[1]):
        step = np.zeros(columns.shape[1])
        step[number] = 1e-3
        high, low = (
            simulated_recording(changed_model(model, sign * step), made, ()).simulate()[rows]
            for sign in (1.0, -1.0))
        derivative = (high - low) / 2e-3
        derivative -= derivative.mean()
        column = columns[:, number] - columns[:, number].mean()
        assert np.linalg.norm(derivative - column) < 0.02 * np.linalg.norm(column) + 1e-8


def slow(recorded):
    """Play a recording again, so slowly that no mode shows in it."""
    generator = np.random.default_rng(9)
    voltage_v = 50.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    displacement_um = behind_mode(0.1 * voltage_v, MODE_RAD_PER_S, DAMPING_RATIO)
    return replace(recorded, path="slow", voltage_v=voltage_v,
                   displacement_um=displacement_um + noise_um)


@pytest.mark.parametrize(("was_there", "came"), [
    (True, "before the identification"),
    pytest.param(False, "after the identification", marks=pytest.mark.long)])
def test_a_mode_that_no_parameter_makes_up_for_is_told_when_it_came(was_there, came):
    # A model without the mode leaves it in both recordings if it was there all along.
    diagnosis = found(LINE, recording("1", 1, other_mode=True),
                      recording("2", 2, other_mode=was_there))
    first = diagnosis.effects[0]
    assert diagnosis.verdict == "explained"
    assert (first["name"], first["came"]) == ("vibration_mode", came)


def test_recordings_that_do_not_show_an_effect_do_not_tell_when_it_came():
    diagnosis = found(LINE, recording("1", 1, other_mode=True), slow(recording("2", 2)))
    first = diagnosis.effects[0]
    assert (first["name"], first["came"]) == ("vibration_mode", "not decidable")


def test_progress_of_a_model_that_does_not_settle_ends_before_effects_compete():
    """A problem whose fits go on improving: every turn is taken, and told."""
    fit = SimpleNamespace(has_converged=False, effects=(), later=())
    problem = SimpleNamespace(own=(), fit=lambda *_, **__: fit)
    told = []

    def progress(_, fraction):
        told.append(fraction)

    assert settled(problem, progress) is fit
    compete = _turn_of(progress, 0)
    compete("", 0.0)
    assert len(told) > 2 and told == sorted(told)


def fit_of(*effects):
    return SimpleNamespace(effects=effects)


def test_the_most_probable_set_is_named():
    delay, lag = fit_of(Delay(1e-4)), fit_of(SensorLag(1e-4, 0.25))
    compared = Selection(None, fit_of(), delay, [], {"sensor_lag": "delay", "creep": "delay"}, {},
                         (lag,))
    told = led_by_the_most_probable(compared, Competition({"sensor_lag": 0.7, "delay": 0.3}))
    assert told.end is lag and told.alternatives == (delay,)
    assert told.indistinguishable == {"delay": "sensor_lag", "creep": "sensor_lag"}
    assert led_by_the_most_probable(
        compared, Competition({"delay": 0.6, "sensor_lag": 0.4})) is compared
    along = SimpleNamespace(since=False, names=("delay",))
    assert led_by_the_most_probable(
        compared, Competition({"sensor_lag": 0.6, "delay": 0.4}, along)) is compared


def test_an_effect_beside_which_another_is_not_needed_is_named_alone():
    delay, both = fit_of(Delay(1e-4)), fit_of(Delay(1e-4), SensorLag(1e-4, 0.25))
    compared = Selection(None, fit_of(), both, [], {"creep": "sensor_lag"}, {}, (), (delay,))
    told = led_by_the_most_probable(compared, Competition({"delay": 0.6, "delay+sensor_lag": 0.4}))
    assert told.end is delay and told.indistinguishable == {}
    nothing = led_by_the_most_probable(compared, Competition({"none": 0.6, "delay": 0.4}))
    assert nothing.end is compared.start
