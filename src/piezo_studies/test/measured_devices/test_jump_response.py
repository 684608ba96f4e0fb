# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag
from piezo_studies.measured_devices.jump_response import (
    estimate_jump_dynamics,
    free_decay_poles,
    jump_response,
)

pytestmark = pytest.mark.kernels

PERIOD_S = 2e-4
NOISE_UM = 0.02
ONE_MODE = ElectricVibrationDynamics(1.5e-4, (6000.0,), (0.03,))
TWO_MODES = ElectricVibrationDynamics(
    1e-4, (6000.0, 10_800.0), (0.03, 0.035), (7900.0,), (0.05,)
)


def recorded(dynamics, seed=0, jump_v=-80.0):
    """Rest at 0 V, a jump, and a slow rise."""
    density = np.tril(4e-4 * np.ones((40, 40)))
    stage = StageModel(PreisachModel(-150.0, 150.0, density), CreepDynamics(), dynamics)
    voltage_v = np.concatenate([np.zeros(300), jump_v + 0.1 * np.arange(500)])
    memory = stage.memory(hysteresis=None)
    displacement_um = stage.simulate(voltage_v, PERIOD_S, memory)
    noise_um = np.random.default_rng(seed).normal(scale=NOISE_UM, size=voltage_v.size)
    return Recording(
        path="jump.csv", sample_rate_hz=1.0 / PERIOD_S, sample_index=np.arange(voltage_v.size),
        sample_periods_s=np.full(voltage_v.size, PERIOD_S), voltage_v=voltage_v,
        displacement_um=displacement_um + noise_um,
        flags=np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32),
    )


@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
@pytest.mark.parametrize("truth", [ONE_MODE, TWO_MODES])
def test_modes_are_recovered_within_their_uncertainty(truth, seed):
    estimate = estimate_jump_dynamics(jump_response(recorded(truth, seed)))
    assert estimate.order == len(truth.mode_frequencies_rad_per_s)
    for name in ("mode_frequencies_rad_per_s", "damping_ratios"):
        error = np.subtract(getattr(estimate.model, name), getattr(truth, name))
        assert (np.abs(error) < 4.5 * np.array(estimate.standard_deviations[name])).all()
    assert estimate.model.mode_frequencies_rad_per_s == pytest.approx(
        truth.mode_frequencies_rad_per_s, rel=5e-3
    )
    assert estimate.residual_rms == pytest.approx(NOISE_UM, rel=0.15)


def test_the_first_part_foretells_the_rest():
    response = jump_response(recorded(TWO_MODES), 0.04)
    model = estimate_jump_dynamics(response.first(0.015), 2).model
    basis = response.basis(model)
    rest_um = response.displacement_um - basis @ np.linalg.lstsq(
        basis, response.displacement_um, rcond=None)[0]
    assert np.std(rest_um[response.time_s > 0.015]) < 1.3 * NOISE_UM


def test_the_jump_is_at_time_zero():
    response = jump_response(recorded(ONE_MODE))
    assert response.voltage_v[response.jump - 1] == 0.0
    assert response.voltage_v[response.jump] == -80.0
    assert response.time_s[response.jump] == 0.0
    assert response.first(0.01).time_s[-1] == pytest.approx(0.01 - PERIOD_S)


def test_a_voltage_without_a_jump_is_refused():
    recording = recorded(ONE_MODE)
    smooth = replace(recording, voltage_v=np.linspace(0.0, 50.0, recording.voltage_v.size))
    with pytest.raises(ValueError, match="jump.csv has no jump of the voltage that stands out"):
        jump_response(smooth)


def test_a_record_that_ends_in_the_ringing_is_refused():
    with pytest.raises(ValueError, match="jump.csv .* record longer"):
        jump_response(recorded(ONE_MODE), duration_s=1.0)


def test_the_subspace_start_is_exact_without_noise():
    rates = np.array([-400.0 + 4900.0j, -400.0 - 4900.0j, -2000.0])
    time_s = np.arange(1, 400) * 25e-6
    decay = 3.0 + np.real(np.exp(np.outer(time_s, rates)) @ [1.0 - 1.0j, 1.0 + 1.0j, 2.0])
    poles = free_decay_poles(decay, 25e-6, 3)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(rates), rtol=1e-6)
