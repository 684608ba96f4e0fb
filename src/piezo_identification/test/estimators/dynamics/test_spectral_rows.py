# SPDX-License-Identifier: BSD-3-Clause
"""Lines of the spectrum of a long record tell what its samples tell."""

import numpy as np
import pytest

from piezo_identification.estimators.dynamics.fast_record import LONG, FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S = 1e-5
POLES = np.array([-8e3, -160.0 + 7.5e3j, -160.0 - 7.5e3j])
RESIDUES = np.array([5e3, 90.0 - 900.0j, 90.0 + 900.0j])
DELAY = 1.3


@pytest.fixture(scope="module")
def record():
    """A multisine that goes on, noise, and an offset."""
    draw = np.random.default_rng(1)
    tones = np.zeros(5_001, dtype=complex)
    tones[5:300] = np.exp(2j * np.pi * draw.random(295))
    given = np.tile(np.fft.irfft(tones, 10_000), 9)
    held = HeldInput(given / given.std(), PERIOD_S, False)
    rows = np.arange(500, given.size - 10)
    measured = (held.responses(POLES, DELAY, rows).value @ RESIDUES).real + 3.0
    measured += draw.normal(0.0, 1e-4, rows.size)
    return FastRecord(held, rows, measured, np.ones((rows.size, 1)))


@pytest.mark.parametrize("delay", [0.0, DELAY, -0.4])
def test_the_spectrum_of_responses_is_the_response_of_the_spectrum(record, delay):
    lines = record.thinned(2000)
    assert record.kept.size > LONG and lines.kept.size <= 2000
    in_time = record.input.responses(POLES, delay, record.kept)
    again = FastRecord(record.input, record.kept, (in_time.value @ RESIDUES).real,
                       record.fixed).thinned(2000)
    direct = (lines.input.responses(POLES, delay).value @ RESIDUES).real
    beside = lines.input.transients(POLES)
    left = again.measured_um - direct
    left -= beside @ np.linalg.lstsq(beside, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(direct).max()


def test_derivatives_are_those_of_the_responses(record):
    lines, step = record.thinned(2000).input, 1e-4
    answer = lines.responses(POLES, DELAY)
    ahead, behind = (lines.responses(POLES + sign * step, DELAY).value for sign in (1, -1))
    assert answer.by_pole == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-3)
    late, early = (lines.responses(POLES, DELAY + sign * step).value for sign in (1, -1))
    assert answer.by_delay == pytest.approx((late - early) / (2.0 * step), rel=1e-3, abs=1e-9)


@pytest.mark.long
def test_the_dynamics_of_a_long_record_are_found_to_the_noise(record):
    estimate = fit_output_error(record)
    assert estimate.residual_rms == pytest.approx(1e-4, rel=0.1)
    mode = estimate.effects[0]
    assert mode.frequency_rad_per_s == pytest.approx(np.abs(POLES[1]), rel=1e-5)
    assert estimate.delay.samples == pytest.approx(DELAY, abs=0.01)


def test_rare_steps_show_a_resonance_far_above_their_own_frequency():
    steps = np.repeat([0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0.0], 10_000)
    held = HeldInput(steps, PERIOD_S, False)
    rows = np.arange(steps.size - 2)
    measured = (held.responses(POLES, 0.0, rows).value @ RESIDUES).real
    lines = FastRecord(held, rows, measured, np.ones((rows.size, 1))).thinned(600).input
    assert np.any(np.abs(lines.phases / (np.abs(POLES[1]) * PERIOD_S) - 1.0) < 0.05)
    assert lines.phases.max() > 0.9 * np.pi
