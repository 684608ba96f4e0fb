# SPDX-License-Identifier: BSD-3-Clause
import json
import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from typing import ClassVar

import control
import numpy as np
import pytest

from piezo_common import registered as registered_module
from piezo_models.cascade import StageModel
from piezo_models.effects import (
    EFFECTS,
    GROUP,
    Effect,
    Evidence,
    fitted_values,
    known_effects,
    with_fitted_values,
)
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.amplitude_damping import AmplitudeDamping
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.converter_steps import SensorSteps, VoltageSteps
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.creep import Creep
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import PLACES, parameter
from piezo_models.effects.gain_drift import GainDrift
from piezo_models.effects.hysteresis import Hysteresis
from piezo_models.effects.hysteretic_spring import HystereticSpring
from piezo_models.effects.outliers import Outliers
from piezo_models.effects.periodic_disturbance import PeriodicDisturbance
from piezo_models.effects.rate_dependent_hysteresis import RateDependentHysteresis
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.slew_limit import SlewLimit
from piezo_models.effects.stiffening import Stiffening
from piezo_models.effects.thermal_drift import ThermalDrift
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_models.effects.voltage_relaxation import VoltageRelaxation
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model

PERIOD_S = 25e-6
EXAMPLES = (
    Creep((0.01, 0.02), (0.01, 1.0)),
    ThermalDrift(0.1, 0.2, 3.0, (0.05, -0.02), 10.0),
    GainDrift(-0.1, 0.02, 5.0),
    VibrationMode(6000.0, 0.05, 0.3),
    CoupledMode(6000.0, 0.05, 0.3, 0.1),
    Delay(1e-4),
    SensorLag(2e-4, 0.3),
    SensorNonlinearity(0.1, 0.2, 0.1, -0.05, 10.0, 20.0),
    PeriodicDisturbance(50.0, 0.1, 0.2),
    SlewLimit(1e5, 0.9, -0.002),
    VoltageClipping(-5.0, 90.0, 1.0),
    Hysteresis((0.05, 0.1), (0.02, -0.01), (0.1, 0.5), 10.0, 9.0),
    BoucWenHysteresis(1.0, 4.0, 0.5),
    CurvedBoucWenHysteresis(1.0, 4.0, 0.5, curvature_per_v=1e-3),
    RateDependentHysteresis(0.05, 100.0, 0.3, 1e-3),
    AmplifierLag(4e-5),
    SecondOrderAmplifier(4e-5, 0.7),
    VoltageRelaxation(4e-4, 0.3),
    BandLimitedVoltage(),
    Stiffening(0.1, 0.2, 0.3, 10.0, 20.0, 5000.0, 0.1),
    HystereticSpring(-0.2, 0.01, 0.2, 2.0, -0.5, 1.0, 10.0, 10.0, 5000.0, 0.1),
    AmplitudeDamping(0.01, 0.5, 10.0, 5000.0, 0.1),
    Backlash(0.1),
    VoltageSteps(1.0, 0.1, 0.02),
    SensorSteps(1.0, 0.05, 0.01),
    Outliers(0.01, 0.5, 0.06),
)


def wave(samples=4000, periods=5):
    return 10.0 + 8.0 * np.sin(2.0 * np.pi * periods * np.arange(samples) / samples)


def stage(effects=()):
    density = np.tril(np.full((20, 20), 0.004))
    return StageModel(
        PreisachModel(-20.0, 120.0, density, -5.0), CreepDynamics((0.1,), (0.11,)),
        ElectricVibrationDynamics(5e-4, (5000.0,), (0.1,)), effects=effects,
    )


def test_every_effect_of_the_package_has_an_example_a_place_and_an_experiment():
    assert [type(effect) for effect in EXAMPLES] == list(EFFECTS)
    assert all(kind.place in PLACES and kind.experiment for kind in EFFECTS)
    assert list(known_effects())[: len(EFFECTS)] == [kind.name for kind in EFFECTS]


@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda effect: effect.name)
def test_fitted_values_go_there_and_back(effect):
    if effect.name == "outliers":
        return
    values, low, high = fitted_values(effect)
    assert ((low <= values) & (values <= high)).all()
    again = with_fitted_values(effect, values)
    for name, value in effect.parameters().items():
        assert getattr(again, name) == pytest.approx(value)


@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda effect: effect.name)
def test_the_model_file_keeps_effects(effect, tmp_path):
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(stage((effect,)), (-20.0, 120.0)))
    assert load_model(path).model.effects == (effect,)


@pytest.mark.parametrize(("change", "message"), [
    (lambda entry: entry.update(name="ghost"), "no effect that is installed"),
    (lambda entry: entry["parameters"].pop("delay_s"), "is missing"),
    (lambda entry: entry["parameters"].update(delay_s=-1.0), "delay_s of delay is -1"),
])
def test_a_model_file_with_an_unknown_or_wrong_effect_is_refused(change, message, tmp_path):
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(stage((Delay(1e-4),)), (-20.0, 120.0)))
    document = json.loads(path.read_text())
    change(document["effects"][0])
    path.write_text(json.dumps(document))
    with pytest.raises(ModelFileError, match=message):
        load_model(path)


@pytest.mark.parametrize("effect", [
    effect for effect in EXAMPLES
    if effect.follows_voltage and effect.name not in (
        "voltage_clipping", "slew_limit", "creep", "voltage_steps", "sensor_steps")
], ids=lambda effect: effect.name)
def test_compensation_undoes_the_effect_on_a_periodic_signal(effect):
    wanted = wave()
    signal = effect.compensate(wanted, PERIOD_S)
    reached = effect.apply(np.tile(signal, 4), PERIOD_S)[-wanted.size :]
    # Play is taken up within the sample after each reversal.
    tolerance = {"backlash": 2e-3}.get(effect.name, 2e-4)
    assert np.abs(reached - wanted).max() < tolerance * np.ptp(wanted)


def test_what_the_amplifier_does_not_give_is_refused():
    assert VoltageClipping(0.0, 20.0).compensate(wave(), PERIOD_S) == pytest.approx(wave())
    with pytest.raises(ValueError, match="reduce the motion"):
        VoltageClipping(0.0, 15.0).compensate(wave(), PERIOD_S)
    bent = VoltageClipping(0.0, 18.5, 1.0)
    assert bent.apply(bent.compensate(wave(), PERIOD_S), PERIOD_S) == pytest.approx(wave())
    with pytest.raises(ValueError, match="slower"):
        SlewLimit(100.0).compensate(wave(), PERIOD_S)


@pytest.mark.parametrize(("effect", "system"), [
    (VibrationMode(3000.0, 0.05, 0.3), 0.7 + 0.3 * VibrationMode(3000.0, 0.05, 0.3).state_space()),
    (Creep((0.02,), (0.005,)), Creep((0.02,), (0.005,)).state_space()),
], ids=["vibration_mode", "creep"])
def test_linear_effects_act_on_samples_as_their_system_does(effect, system):
    signal = wave(40_000, 20)
    response = control.forced_response(
        system, np.arange(signal.size) * PERIOD_S, signal - signal[0],
        interpolate=True,
    ).outputs
    rest = float(system.dcgain()) * signal[0]
    np.testing.assert_allclose(effect.apply(signal, PERIOD_S), response + rest, atol=1e-6)


def test_a_linear_effect_is_a_part_of_the_stages_linear_system():
    effect = Creep((0.02,), (0.005,))
    frequency_hz = np.array([1.0, 300.0, 900.0])
    ratio = stage((effect,)).response(frequency_hz) / stage().response(frequency_hz)
    expected = effect.state_space()(2j * np.pi * frequency_hz)
    np.testing.assert_allclose(ratio, expected, rtol=1e-9)
    system = stage((effect,)).linear()
    np.testing.assert_allclose(
        system(2j * np.pi * frequency_hz), stage((effect,)).response(frequency_hz), rtol=1e-6
    )


def test_a_further_mode_moves_beside_the_others_behind_the_same_lag():
    model, modes = stage(), [VibrationMode(9000.0, 0.01, 0.004), VibrationMode(3000.0, 0.05, 0.3)]
    s = 2j * np.pi * np.array([1.0, 300.0, 900.0, 1430.0])
    lag = model.creep.state_space()(s) / (model.dynamics.time_constant_s * s + 1.0)
    expected = 0.696 * model.linear()(s) + lag * (
        0.004 * modes[0].state_space()(s) + 0.3 * modes[1].state_space()(s))
    extended = stage(tuple(modes))
    np.testing.assert_allclose(extended.linear()(s), expected, rtol=1e-9)
    np.testing.assert_allclose(extended.response(s.imag / (2.0 * np.pi)), expected, rtol=1e-9)


def test_slow_waves_of_a_drift_stay_as_they_end():
    drift = ThermalDrift(0.0, 0.0, 1.0, (0.5,), 0.05)
    drifted = drift.apply(np.zeros(4000), PERIOD_S)
    assert drifted[1000] == pytest.approx(-1.0, abs=1e-6)
    np.testing.assert_allclose(drifted[2000:], 0.0, atol=1e-12)


def test_harmonics_of_a_disturbance_are_multiples_of_it():
    tones = PeriodicDisturbance(100.0, 0.0, 0.0, (0.3,), (0.1,)).apply(np.zeros(400), PERIOD_S)
    phase = 2.0 * np.pi * 200.0 * PERIOD_S * np.arange(400)
    np.testing.assert_allclose(tones, 0.3 * np.cos(phase) + 0.1 * np.sin(phase), atol=1e-12)


def test_the_stage_applies_effects_at_their_places():
    voltage_v = 50.0 + 60.0 * np.sin(2.0 * np.pi * 20.0 * np.arange(8000) * PERIOD_S)
    clipped = stage((VoltageClipping(0.0, 80.0),)).simulate(voltage_v, PERIOD_S)
    expected = stage().simulate(np.clip(voltage_v, 0.0, 80.0), PERIOD_S)
    np.testing.assert_allclose(clipped, expected)
    sensor, play = SensorNonlinearity(0.1, 0.2, 0.1, 0.0, 10.0, 20.0), Backlash(0.1)
    both = stage((sensor, play)).simulate(voltage_v, PERIOD_S)
    plain = stage().simulate(voltage_v, PERIOD_S)
    expected = sensor.apply(play.apply(plain, PERIOD_S), PERIOD_S)
    np.testing.assert_allclose(both, expected)


PARTS = ([], [1], [1, 2, 3], [700], [5, 5, 1000], list(range(100, 1500, 100)))


@pytest.mark.parametrize("effect", [
    *EXAMPLES, Delay(0.0), Delay(0.3 * PERIOD_S), Delay(1.7 * PERIOD_S), Delay(400.2 * PERIOD_S),
    SensorLag(2e-4), PeriodicDisturbance(50.0, 0.1, 0.2, (0.1,), (0.05,)),
], ids=lambda effect: f"{effect.name} {next(iter(effect.parameters().values()), None)}")
def test_a_simulation_in_parts_is_the_whole(effect):
    random = np.random.default_rng(2)
    voltage_v = np.cumsum(random.normal(scale=2.0, size=1500)).clip(-20.0, 120.0)
    model = replace(stage((effect,)), hysteretic_creep=HystereticCreep((5.0,), (0.01,), (0.02,)))
    whole = model.simulate(voltage_v, PERIOD_S)
    for edges in PARTS:
        memory = model.memory()
        parts = [model.simulate(part, PERIOD_S, memory) for part in np.split(voltage_v, edges)]
        np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0.0, atol=1e-11)


def test_a_simulation_in_parts_is_the_whole_with_all_effects_and_copies_go_their_own_way():
    random = np.random.default_rng(3)
    voltage_v = random.uniform(-20.0, 120.0, 900)
    model = stage(EXAMPLES)
    memory = model.memory()
    model.simulate(voltage_v[:400], PERIOD_S, memory)
    copy = memory.copy()
    model.simulate(random.uniform(-20.0, 120.0, 50), PERIOD_S, memory)
    np.testing.assert_allclose(
        model.simulate(voltage_v[400:], PERIOD_S, copy),
        model.simulate(voltage_v, PERIOD_S)[400:], rtol=0.0, atol=1e-11)


def test_what_an_effect_applies_is_what_it_does_in_parts():
    """Also from another rest than the first value, which `advance` does not know of."""
    signal = wave(300, 2)
    for effect in EXAMPLES:
        if effect.place in ("voltage", "displacement", "sensor"):
            behind, past = [], None
            for part in np.split(signal, [50, 120]):
                made, past = effect.advance(part, PERIOD_S, past)
                behind.append(made)
            np.testing.assert_allclose(
                np.concatenate(behind), effect.apply(signal, PERIOD_S), rtol=0.0, atol=1e-12)


def test_only_loops_that_drift_remember_voltages_of_long_ago():
    earlier_v, signal = wave(300, 2), wave(200, 3)
    remembering = {effect: past for effect in EXAMPLES if effect.place == "voltage"
                   and (past := effect.memory_after(earlier_v)) is not None}
    assert {effect.name for effect in remembering} == {
        "bouc_wen_hysteresis", "curved_bouc_wen_hysteresis"}
    for effect, past in remembering.items():
        behind = effect.apply(np.append(earlier_v, signal), PERIOD_S)[earlier_v.size :]
        np.testing.assert_array_equal(effect.advance(signal, PERIOD_S, past)[0], behind)


@pytest.mark.parametrize("period_s", [PERIOD_S, 1.0])
def test_a_sample_changes_no_other_behind_effects_that_act_at_once(period_s):
    signal, changed = wave(), wave()
    changed[700] += 3.0
    at_once = [effect for effect in EXAMPLES if effect.acts_at_once(period_s)]
    for effect in at_once:
        behind = [np.delete(effect.apply(each, period_s), 700) for each in (signal, changed)]
        np.testing.assert_array_equal(*behind, err_msg=effect.name)
    assert {effect.name for effect in at_once} == {
        "thermal_drift", "gain_drift", "sensor_nonlinearity", "periodic_disturbance",
        "voltage_clipping", "voltage_steps", "sensor_steps", "outliers",
        *(["stiffening"] if period_s == 1.0 else [])}


@pytest.mark.parametrize("effect", [
    effect for effect in EXAMPLES if effect.place in ("voltage", "displacement", "sensor")
    and effect.name != "stiffening"], ids=lambda effect: effect.name)
def test_an_effect_remembers_no_more_the_longer_it_goes_on(effect):
    def remembered(parts):
        past = None
        for _ in range(parts):
            _, past = effect.advance(wave(100, 1), PERIOD_S, past)
        return np.size(past)

    assert remembered(20) == remembered(2)


def test_a_guess_of_a_delay_stays_within_its_bounds_in_a_recording_of_minutes():
    displacement_um = wave(4000)
    velocity = np.gradient(displacement_um, 0.1)
    # What drifts for minutes explains a slow motion as a delay of 20 s would.
    shown = Evidence(
        0.1, displacement_um, displacement_um, -20.0 * velocity, 1e-3,
        ElectricVibrationDynamics(), displacement_um,
        lambda contributions: (np.array([20.0]), 1.0), lambda contribution: 1.0)
    longest_s = 0.1 * 4000 * 0.1
    assert all(guess.delay_s <= longest_s for guess in Delay.starts(shown))


@pytest.mark.parametrize("kind", [Stiffening, SensorNonlinearity])
def test_a_model_that_moves_by_rounding_only_hints_at_no_curve(kind):
    still_um = 3.0 + 1e-15 * np.arange(4000)
    shown = Evidence(
        PERIOD_S, still_um, still_um, np.ones(4000), 1e-3,
        ElectricVibrationDynamics(0.0, (6000.0,), (0.05,)), still_um,
        lambda *_: pytest.fail("nothing is to be fitted"), lambda contribution: 1.0)
    assert kind.starts(shown) == []


def test_a_delay_of_part_of_a_sample_is_exact_for_slow_signals():
    time_s = np.arange(4000) * PERIOD_S
    for delay_s in (0.3 * PERIOD_S, 4.6 * PERIOD_S):
        late = Delay(delay_s).apply(np.sin(1000.0 * time_s), PERIOD_S)
        np.testing.assert_allclose(
            late[100:], np.sin(1000.0 * (time_s[100:] - delay_s)), atol=1e-5
        )


def test_the_slew_limit_gives_the_mean_of_what_it_allows():
    held = SlewLimit(40_000.0).apply(np.array([0.0, 3.0, 3.0, 3.0, 3.0, 3.0]), PERIOD_S)
    np.testing.assert_allclose(held, [0.0, 0.5, 1.5, 2.5, 3.0, 3.0])


@pytest.mark.parametrize("time_constant_s", [1e-6, 2e-4, 1e-2])
@pytest.mark.parametrize("roundness", [0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.0999, 0.1001, 0.25, 0.5])
def test_a_lag_of_any_roundness_is_exact_for_straight_lines(time_constant_s, roundness):
    """A ramp behind 1 / (1 + T s + r (T s)^2), by the roots of its characteristic equation."""
    time_s = np.arange(4000) * PERIOD_S
    lagging = SensorLag(time_constant_s, roundness).apply(time_s, PERIOD_S)
    apart = time_constant_s * np.sqrt(1.0 - 4.0 * roundness + 0j)
    slow = 0.5 * (time_constant_s + apart)
    fast = roundness * time_constant_s**2 / slow
    if roundness == 0.25:
        rest = (time_s + time_constant_s) * np.exp(-time_s / slow)
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            fast_rest = np.where(time_s > 0.0, fast**2 * np.exp(-time_s / fast), fast**2)
        rest = (slow**2 * np.exp(-time_s / slow) - (fast_rest if fast else 0.0)) / apart
    np.testing.assert_allclose(
        lagging, (time_s - time_constant_s + rest).real, atol=1e-11 * time_s[-1])


def test_a_lag_hardly_changes_with_its_roundness_from_zero_on():
    signal = wave()
    sharp = SensorLag(2e-4).apply(signal, PERIOD_S)
    slopes = [(SensorLag(2e-4, roundness).apply(signal, PERIOD_S) - sharp) / roundness
              for roundness in (1e-9, 1e-7, 1e-5, 1e-3)]
    for slope in slopes[:-1]:
        np.testing.assert_allclose(slope, slopes[-1], atol=2e-2 * np.abs(slopes[-1]).max())


def test_a_parameter_outside_its_bounds_is_refused():
    with pytest.raises(ValueError, match="time_constant_s of sensor_lag"):
        SensorLag(-1.0)


@dataclass(frozen=True)
class Leak(Effect):
    name: ClassVar[str] = "leak"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "rest"

    share: float = parameter("1", "linear", 0.0, 1.0)

    def apply(self, signal, sample_period_s, rest=None):
        return signal * (1.0 - self.share)

    @classmethod
    def starts(cls, evidence):
        return [cls(0.0)]


@pytest.fixture
def announce(monkeypatch):
    """Let another package announce a class of this module as an effect."""
    def announce(name, class_name):
        monkeypatch.setitem(sys.modules, "lab_effects", sys.modules[__name__])
        points = [EntryPoint(name, f"lab_effects:{class_name}", GROUP)]
        monkeypatch.setattr(registered_module, "_announced", lambda group, path: points)

    return announce


def test_another_package_adds_an_effect_by_an_entry_point(announce, tmp_path):
    announce("leak", "Leak")
    assert known_effects()["leak"] is Leak
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(stage((Leak(0.1),)), (-20.0, 120.0)))
    assert load_model(path).model.effects == (Leak(0.1),)


def test_two_effects_of_one_name_are_refused(announce):
    announce("delay", "Leak")
    with pytest.raises(ValueError, match="two effects are named delay"):
        known_effects()
