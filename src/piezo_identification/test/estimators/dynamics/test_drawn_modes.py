# SPDX-License-Identifier: BSD-3-Clause
"""Drawn modes are found to the noise, and what is written is the best of what was tried."""

from dataclasses import dataclass
from functools import cache

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.dynamics.pole_search import free_fits
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_fit import estimate_from_response
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S, SAMPLES, HELD = 1e-4, 12_000, 4
NOISE = 1e-3  # over the RMS of the output
TWINS = 1.02  # ratio of frequencies that are nearly the same
DRAWS = range(3)
pytestmark = pytest.mark.long


@dataclass(frozen=True)
class DrawnStage:
    """Modes that add up, a lag of the opposite sign beside them, a direct part, and a delay.

    It is a sum of residues over s minus poles, solved exactly between the steps of its input.
    """

    poles: np.ndarray
    residues: np.ndarray
    direct: float
    delay: float  # in sample periods

    @classmethod
    def drawn(cls, seed):
        """One to five modes of 100 Hz to 2 kHz, damped by 0.3 to 5 %, some of them twins."""
        draw = np.random.default_rng(seed)
        count = int(draw.integers(1, 6))
        w = np.sort(2.0 * np.pi * np.exp(draw.uniform(np.log(100.0), np.log(2000.0), count)))
        for mode in range(1, count):
            if draw.random() < 0.3:
                w[mode] = TWINS * w[mode - 1]
        damping = np.exp(draw.uniform(np.log(0.003), np.log(0.05), count))
        parts = draw.uniform(0.1, 1.0, count)
        direct = draw.choice([0.0, draw.uniform(0.0, 0.05)])
        opposite = draw.choice([0.0, draw.uniform(0.02, 0.1)])
        lag_s = draw.uniform(2.0, 20.0) * PERIOD_S
        delay = draw.choice([0.0, draw.uniform(0.0, 4.0)])
        poles = w * (-damping + 1j * np.sqrt(1.0 - damping**2))
        residues = parts / parts.sum() * (1.0 + opposite - direct) * w**2 / (1j * poles.imag)
        return cls(np.append(poles, -1.0 / lag_s), np.append(residues, -opposite / lag_s), direct,
                   delay)

    def response(self, rate_rad_per_s):
        """Return the frequency response, the real part of whose impulse response it has."""
        s = 1j * rate_rad_per_s[:, None]
        both = self.residues / (s - self.poles) + self.residues.conj() / (s - self.poles.conj())
        turn = np.exp(-1j * rate_rad_per_s * self.delay * PERIOD_S)
        return turn * (self.direct + 0.5 * both.sum(axis=1))

    def output(self, held):
        """Return the output at the steps of an input that begins at zero."""
        late = int(np.ceil(self.delay))
        part_s = (late - self.delay) * PERIOD_S
        total = self.direct * held
        for pole, residue in zip(self.poles, self.residues, strict=True):
            decay, rest = np.exp(pole * PERIOD_S), np.exp(pole * part_s)
            state = lfilter([0.0, (decay - 1.0) / pole], [1.0, -decay], held)
            total = total + (residue * (rest * state + (rest - 1.0) / pole * held)).real
        return total[np.clip(np.arange(held.size) - late, 0, held.size - 1)]


def recorded(seed):
    """Return a record of a drawn stage that answers noise, and the noise of its sensor."""
    draw = np.random.default_rng(1000 + seed)
    held = draw.normal(size=SAMPLES // HELD).repeat(HELD)
    held[0] = 0.0
    output = DrawnStage.drawn(seed).output(held)
    noise = NOISE * output.std()
    rows = np.arange(SAMPLES - 2)
    measured = output[rows] + draw.normal(0.0, noise, rows.size)
    return FastRecord(HeldInput(held, PERIOD_S, False), rows, measured,
                      np.ones((rows.size, 1))), noise


def left_by(estimate, record):
    """Return what the numbers that are written leave of a record, beside gain and offset."""
    modes = [effect for effect in estimate.effects if effect.place == "modes"]
    system = estimate.model.state_space(modes)
    for lag in estimate.effects:
        if lag not in modes:
            system = control.ss(control.tf([1.0], [lag.time_constant_s, 1.0])) * system
    poles, vectors = np.linalg.eig(system.A)
    residues = (system.C @ vectors)[0] * np.linalg.solve(vectors, system.B)[:, 0]
    written = DrawnStage(poles, residues, 0.0, estimate.delay_s / PERIOD_S)
    columns = np.column_stack([written.output(record.input.samples)[record.kept], record.fixed])
    gains = np.linalg.lstsq(columns, record.measured_um, rcond=None)[0]
    return np.sqrt(np.mean((record.measured_um - columns @ gains) ** 2))


@cache
def estimated(seed):
    """Return record, noise, estimate, and what the estimate leaves."""
    record, noise = recorded(seed)
    estimate = fit_output_error(record)
    return record, noise, estimate, left_by(estimate, record)


def test_a_generous_start_has_all_drawn_poles():
    """Every one of these: a pair less each time begins from there."""
    over_noise = []
    for seed in range(2 * len(DRAWS)):
        record, noise = recorded(seed)
        fits = list(free_fits(record.thinned(2000), 8))
        over_noise.append(np.sqrt(min(fit.cost for fit in fits) / fits[0].residual.size) / noise)
    assert max(over_noise) < 1.1


def test_what_is_written_leaves_the_noise():
    good = [left < 1.5 * noise for _, noise, _, left in map(estimated, DRAWS)]
    assert all(good), good


def test_nothing_is_written_that_is_worse_than_what_was_tried():
    """More may be left by what has fewer numbers, as far as these pay for it."""
    for seed in DRAWS:
        record, noise, estimate, left = estimated(seed)
        chosen = next(trial for trial in estimate.trials if trial.order == estimate.order)
        assert chosen.information == min(trial.information for trial in estimate.trials)
        assert left <= max(1.02 * estimate.residual_rms, 1.05 * noise), seed


def test_a_measured_response_of_the_same_stages_is_left_to_the_noise():
    frequency_hz = np.geomspace(20.0, 4000.0, 1500)  # some lines for each of two twins
    for seed in DRAWS:
        draw = np.random.default_rng(2000 + seed)
        gain = DrawnStage.drawn(seed).response(2.0 * np.pi * frequency_hz)
        noise = NOISE * np.sqrt(np.mean(np.abs(gain) ** 2))
        noisy = gain + noise * np.sqrt(0.5) * (
            draw.normal(size=gain.size) + 1j * draw.normal(size=gain.size))
        measured = FrequencyResponse("drawn", frequency_hz, noisy)
        model = estimate_from_response(measured).model
        left = np.sqrt(np.mean(np.abs(model.response(frequency_hz) - noisy) ** 2))
        assert left < 1.5 * noise, seed
