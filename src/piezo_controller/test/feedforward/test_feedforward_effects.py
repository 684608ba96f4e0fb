# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.feasibility import UnreachableReference
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_models.effects import EFFECTS
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
from piezo_models.linear.dynamics import CreepDynamics

pytestmark = pytest.mark.kernels

SAMPLE_PERIOD_S = 25e-6
THIRD_MODE = VibrationMode(8796.0, 0.01, 0.05)

# Each with the error in percent that may be left at 40 Hz, 40 um: further creep does not end, and
# play and a compressive friction ask at reversals for more than the bandwidth of the inverse. Of
# converter steps what they round off is left.
COMPENSATED = [
    (Creep((0.002, 0.003), (0.01, 0.05)), 5e-3), (THIRD_MODE, 1e-6),
    (CoupledMode(8796.0, 0.01, 0.05, 0.01), 1e-6), (Delay(1.3e-4), 1e-6),
    (SensorLag(1e-4), 1e-6), (SensorNonlinearity(0.1, 0.5, 0.3, 0.1, 50.0, 50.0), 1e-6),
    (SlewLimit(1e6), 1e-6), (VoltageClipping(-18.0, 118.0), 1e-6),
    (AmplifierLag(4e-5), 1e-3), (VoltageRelaxation(4e-4, 0.3), 1e-3),
    (SecondOrderAmplifier(4e-5, 0.7), 1e-2), (BandLimitedVoltage(), 1e-6),
    (RateDependentHysteresis(0.02, 1000.0, 0.3, 1e-3), 1e-3),
    (Stiffening(0.3, 0.3, 0.3, 50.0, 50.0, 2846.0, 0.68), 1e-6), (Backlash(0.05), 5e-3),
    (Hysteresis((0.05, 0.1), (0.02, -0.02), (0.0, 0.2), 50.0, 50.0), 1e-6),
    (BoucWenHysteresis(4.0, 15.0, 0.5), 1e-3),
    (CurvedBoucWenHysteresis(4.0, 15.0, 0.5, curvature_per_v=1e-3), 1e-3),
    (AmplitudeDamping(0.02, 0.3, 50.0, 2846.0, 0.68), 1e-2),
    (VoltageSteps(1.0, 1e-3, 0.0), 2e-3), (SensorSteps(1.0, 1e-3, 0.0), 2e-3),
]
SPRING = HystereticSpring(-0.2, 0.02, 0.3, 0.4, 0.1, 1.0, 50.0, 50.0, 2846.0, 0.68)
# A gain that ages does so by the clock and not by the voltage, and when it began is not known.
FROM_OUTSIDE = [ThermalDrift(0.1, 0.2, 1.0), GainDrift(-0.05, 1.0, 50.0),
                PeriodicDisturbance(50.0, 0.03, 0.04),
                Outliers(0.01, 0.5, 0.1)]


def harmonic(frequency_hz=40.0, amplitude_um=40.0):
    return sample_reference(Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0))


@pytest.fixture(scope="module")
def without_creep(stage_model):
    return replace(stage_model, creep=CreepDynamics())


def tracking_error_um(model, plan, samples=8000):
    """Tell what the model's sensor measures in the periodic part, less the reference."""
    begin = len(plan.once_voltage_v)
    measured_um = model.simulate(plan.voltage_v(0, begin + samples), SAMPLE_PERIOD_S)
    return measured_um[begin:] - plan.expected_um(begin, samples)


def rms_percent(error_um, amplitude_um=40.0):
    return 100.0 * np.sqrt(np.mean(error_um**2)) / amplitude_um


@pytest.mark.parametrize("effect, left_percent", COMPENSATED, ids=lambda e: getattr(e, "name", ""))
def test_the_sensor_follows_the_reference_through_every_effect_of_the_model(
        without_creep, effect, left_percent):
    model = replace(without_creep, effects=(effect,))
    plan = plan_feedforward(harmonic(), model)
    assert plan.uncompensated == ()
    assert rms_percent(tracking_error_um(model, plan)) < left_percent


def test_the_sensor_follows_through_a_hysteretic_spring_once_that_repeats(without_creep):
    # Its force forgets how the motion began from period to period, and not at once.
    model = replace(without_creep, effects=(SPRING,))
    settled = slice(-2000, None)
    plan, ignorant = (plan_feedforward(harmonic(), each) for each in (model, without_creep))
    assert plan.uncompensated == ()
    left, without = (
        rms_percent(tracking_error_um(model, each, samples=40000)[settled])
        for each in (plan, ignorant))
    assert left < 0.05
    assert without > 2.0


def test_no_effect_of_the_package_is_untested():
    tested = [type(effect) for effect, _ in COMPENSATED] + [
        type(effect) for effect in (SPRING, *FROM_OUTSIDE)]
    assert set(tested) == set(EFFECTS)


@pytest.mark.parametrize("frequency_hz, amplitude_um", [(500.0, 21.0), (1000.0, 9.0)])
def test_effects_of_every_place_are_compensated_together(without_creep, frequency_hz, amplitude_um):
    model = replace(without_creep, effects=(
        SlewLimit(1.5e6), THIRD_MODE, Delay(2e-4), Stiffening(0.2, 0.1, 0.1, 50.0, 50.0, 0.0, 1.0),
        SensorLag(5e-5)))
    reference_um = harmonic(frequency_hz, amplitude_um)
    ignorant = plan_feedforward(reference_um, without_creep)
    knowing = plan_feedforward(reference_um, model)
    assert rms_percent(tracking_error_um(model, ignorant), amplitude_um) > 10.0
    assert rms_percent(tracking_error_um(model, knowing), amplitude_um) < 0.01


def test_the_approach_expects_what_the_sensor_will_measure(without_creep):
    model = replace(without_creep, effects=(THIRD_MODE, SensorLag(1e-4)))
    plan = plan_feedforward(harmonic(500.0, 21.0), model)
    begin = len(plan.once_voltage_v)
    measured_um = model.simulate(plan.once_voltage_v, SAMPLE_PERIOD_S)
    np.testing.assert_allclose(plan.expected_um(0, begin), measured_um, atol=1e-6)


@pytest.mark.parametrize("effect", FROM_OUTSIDE, ids=lambda effect: effect.name)
def test_what_comes_from_outside_is_left_alone_and_named(without_creep, effect):
    model = replace(without_creep, effects=(effect,))
    plan = plan_feedforward(harmonic(), model)
    assert plan.uncompensated == (effect.name,)
    np.testing.assert_array_equal(
        plan.period_voltage_v, plan_feedforward(harmonic(), without_creep).period_voltage_v)


def test_clipping_by_the_amplifier_refuses_and_names_an_amplitude_within_it(without_creep):
    model = replace(without_creep, effects=(VoltageClipping(-20.0, 60.0),))
    with pytest.raises(UnreachableReference, match="the amplifier gives -20 to 60 V") as refusal:
        plan_feedforward(harmonic(), model)
    assert 0.0 < refusal.value.reachable_um < 40.0
    plan = plan_feedforward(harmonic(amplitude_um=refusal.value.reachable_um), model)
    assert plan.period_voltage_v.max() <= 60.0


def test_compensation_that_takes_too_much_of_the_amplifier_is_done_as_far_as_it_reaches(
        without_creep):
    friction = replace(without_creep, effects=(RateDependentHysteresis(0.1, 100.0, 0.1, 1e-4),))
    reference_um = harmonic(500.0, 21.0)
    ignorant = plan_feedforward(reference_um, without_creep)
    knowing = plan_feedforward(reference_um, friction)
    assert (rms_percent(tracking_error_um(friction, knowing), 21.0)
            < 0.5 * rms_percent(tracking_error_um(friction, ignorant), 21.0))


def test_open_loop_compensates_nothing(without_creep):
    extended = replace(without_creep, effects=(Delay(2e-4), SlewLimit(1.5e6)))
    plans = [plan_feedforward(harmonic(), model, "open_loop")
             for model in (without_creep, extended)]
    np.testing.assert_allclose(plans[1].period_voltage_v, plans[0].period_voltage_v, atol=0.05)


@pytest.mark.long
def test_the_feedback_is_designed_for_the_extended_linear_part(stage_model, controller):
    extended = replace(stage_model, effects=(Creep((0.002, 0.003), (0.01, 0.5)), THIRD_MODE))
    report = design_feedback(extended, load_weights()).report
    # Two relaxations and a mode; the feedback is stable with them.
    assert report["order_before_reduction"] == controller.report["order_before_reduction"] + 4
    assert report["stable_within_gain_spread"]


@pytest.mark.parametrize(("effect", "phase_rad"), [
    (Delay(3e-4), lambda omega: -3e-4 * omega),
    (SensorLag(3e-4), lambda omega: -np.arctan(3e-4 * omega)),
])
@pytest.mark.parametrize("at_once", [False, True])
def test_the_feedback_is_designed_for_what_delays_the_sensor(
        stage_model, effect, phase_rad, at_once):
    frequency_hz = np.array([5.0, 50.0])
    before, after = (
        design_plant(model, 1e-3, 25e-6, at_once)[0](np.exp(2j * np.pi * frequency_hz * 1e-3))
        for model in (stage_model, replace(stage_model, effects=(effect,)))
    )
    assert np.angle(after / before) == pytest.approx(
        phase_rad(2.0 * np.pi * frequency_hz), rel=0.1)
