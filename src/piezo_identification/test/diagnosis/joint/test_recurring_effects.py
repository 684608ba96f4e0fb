# SPDX-License-Identifier: BSD-3-Clause
"""Effects that every recording has of its own: hum and drift that were there all along."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged, smooth_noise_v

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
)
from piezo_identification.fitting.joint_errors import JointErrors
from piezo_identification.fitting.joint_fit import JointProblem
from piezo_identification.fitting.model_weights import held_out_of
from piezo_models.effects.periodic_disturbance import PeriodicDisturbance
from piezo_models.effects.thermal_drift import ThermalDrift
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S, SAMPLES, NOISE_UM = 1e-3, 1500, 2e-3
MODE_RAD_PER_S, DAMPING_RATIO = 400.0, 0.1
HUM_HZ, HUM_UM = 50.03, 0.05

LINE = line_model(MODE_RAD_PER_S, DAMPING_RATIO)


def recording(seed, outside=lambda time_s, generator: 0.0):
    """Record a line with a mode, and what comes from outside at times of its own."""
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, 20)
    displacement_um = behind_mode(0.1 * voltage_v, MODE_RAD_PER_S, DAMPING_RATIO)
    displacement_um += outside(PERIOD_S * np.arange(SAMPLES), np.random.default_rng(100 + seed))
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um, name=f"{seed}")


def hum(time_s, generator):
    phase = 2.0 * np.pi * (HUM_HZ * time_s + generator.random())
    return HUM_UM * (np.sin(phase) + 0.3 * np.sin(2.0 * phase))


def drift(time_s, generator):
    return HUM_UM * generator.normal() * time_s * (1.0 + generator.normal() * time_s)


def test_hum_that_was_there_all_along_has_a_phase_of_its_own_in_every_recording(few_effects):
    bent = replace(LINE, dynamics=ElectricVibrationDynamics(0.0, (390.0,), (0.12,)))
    new, *old = (recording(seed, hum) for seed in (1, 2))
    with few_effects("periodic_disturbance", "thermal_drift"):
        diagnosis = diagnose(
            bent, [new], identified_from=IdentificationRecordings(tuple(old), ()))
    assert diagnosis.verdict == "explained"
    found, = diagnosis.effects
    assert (found["name"], found["came"]) == ("periodic_disturbance", "before the identification")
    assert found["parameters"]["frequency_hz"] == pytest.approx(HUM_HZ, abs=0.01)
    assert diagnosis.after["rms_um"] < 1.05 * NOISE_UM
    assert diagnosis.model.dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(
        MODE_RAD_PER_S, rel=1e-3)


@pytest.mark.usefixtures("likely_effects")
def test_hum_that_came_later_is_not_in_the_identification():
    new, *old = recording(1, hum), recording(2)
    diagnosis = diagnose(LINE, [new], identified_from=IdentificationRecordings(tuple(old), ()))
    found, = diagnosis.effects
    assert (found["name"], found["came"]) == ("periodic_disturbance", "after the identification")


@pytest.mark.parametrize(("outside", "effect"), [
    (hum, PeriodicDisturbance(HUM_HZ + 0.1, 0.0, HUM_UM, (0.0,), (0.01,))),
    pytest.param(drift, ThermalDrift(0.1, 0.0, 1.0, (0.0,) * 7, 3.0), marks=pytest.mark.long),
], ids=["hum", "drift"])
def test_recordings_of_the_identification_have_none_left_and_the_derivatives_are_right(
        outside, effect):
    problem = JointProblem(LINE, [recording(1, outside)], [recording(2, outside)])
    problem.steps = 40
    fitted = problem.start.estimation
    errors = JointErrors(problem.dataset, fitted, fitted | problem.start.validation, 1, (effect,),
                         frozenset())
    vector = errors.vector(np.zeros(errors.count), (effect,))
    residual, jacobian = errors.linearised(vector)
    gradient = jacobian.T @ residual
    for number in range(errors.count, vector.size):
        step = np.zeros(vector.size)
        step[number] = 1e-6
        difference = (errors.value(vector + step) - errors.value(vector - step)) / 2e-6
        assert difference == pytest.approx(
            gradient[number], rel=5e-3, abs=5e-3 * np.linalg.norm(jacobian[:, number]))
    found = problem.fit((effect,))
    clean = JointProblem(LINE, [recording(1)], [recording(2)]).fit(())
    assert _residual_um(found) == pytest.approx(_residual_um(clean), rel=0.03)
    assert found.count > problem.fit((effect,), (effect.name,)).count


def _residual_um(fit):
    return [np.sqrt(held_out.mean_square_um2) for held_out in held_out_of(fit)]
