# SPDX-License-Identifier: BSD-3-Clause
"""The benchmarks of oscillators, on made-up files: Runge and Kutta's rule in place of a circuit."""

import numpy as np
import pytest

from piezo_studies.measured_devices.oscillators import (
    BOUC_WEN_FILES,
    CIRCUIT_FILES,
    bouc_wen,
    circuit,
)

CIRCUIT_S, BOUC_WEN_S = 1.6384e-3, 1.0 / 750.0
STEPS = 6
"""Of the rule, in a sample period."""

FREQUENCY_RAD_PER_S, DAMPING, CUBIC = 430.0, 0.05, 4.0


def multisine(size, amplitude, band=0.3, seed=0):
    random = np.random.default_rng(seed)
    lines = np.zeros(size // 2 + 1, dtype=complex)
    excited = slice(2, int(band * lines.size))
    lines[excited] = np.exp(2j * np.pi * random.random(lines[excited].size))
    wave = np.fft.irfft(lines, size)
    return amplitude * wave / wave.std()


def played(slopes, state, inputs, period_s):
    """First number of the state at each sample; the input is held."""
    step = period_s / STEPS
    read = np.empty(inputs.size)
    for sample, held in enumerate(inputs):
        read[sample] = state[0]
        for _ in range(STEPS):
            a = slopes(state, held)
            b = slopes([x + 0.5 * step * v for x, v in zip(state, a, strict=True)], held)
            c = slopes([x + 0.5 * step * v for x, v in zip(state, b, strict=True)], held)
            d = slopes([x + step * v for x, v in zip(state, c, strict=True)], held)
            state = [x + step / 6.0 * (i + 2.0 * (j + k) + m)
                     for x, i, j, k, m in zip(state, a, b, c, d, strict=True)]
    return read


def cubic_spring(state, held):
    y, speed = state
    w = FREQUENCY_RAD_PER_S
    return speed, w * w * (held - y - CUBIC * y**3) - 2.0 * DAMPING * w * speed


def hysteretic_spring(state, held):
    y, speed, force = state
    return (speed, (held - 10.0 * speed - 5e4 * y - force) / 2.0,
            5e4 * speed - 1e3 * (0.8 * abs(speed) * force - 1.1 * speed * abs(force)))


def write(path, inputs, read, period_s, noise):
    path.parent.mkdir(exist_ok=True)
    read = read + noise * np.random.default_rng(1).normal(size=read.size)
    np.savetxt(path, np.column_stack([period_s * np.arange(read.size), inputs, read]),
               fmt="%.10g", delimiter=",", header="time_s,voltage_v,displacement_um", comments="")


@pytest.mark.long
def test_the_circuit_is_found_to_stiffen_and_the_arrow_is_predicted(tmp_path):
    for name, inputs in (
            (CIRCUIT_FILES[0], multisine(5000, 0.03, 0.5)),
            (CIRCUIT_FILES[1],
             multisine(2000, 0.05, 0.5, seed=2) * np.linspace(0.0, 1.0, 2000))):
        write(tmp_path / name, inputs, played(cubic_spring, [0.0, 0.0], inputs, CIRCUIT_S),
              CIRCUIT_S, 1e-5)
    figures, (finding,) = circuit(tmp_path)
    assert "stiffening" in finding.effects
    linear_mv, diagnosed_mv, linear_arrow_mv, diagnosed_arrow_mv = (
        figure.ours for figure in figures)
    assert diagnosed_mv < 0.2 * linear_mv
    assert diagnosed_arrow_mv < 0.2 * linear_arrow_mv


@pytest.mark.long
def test_the_hysteresis_of_a_spring_is_named_and_unseen_data_are_predicted(tmp_path):
    for name, size, seed in zip(BOUC_WEN_FILES, (6000, 3000, 3000), range(3), strict=True):
        inputs = multisine(size, 50.0, 0.4, seed)
        read = 1e6 * played(hysteretic_spring, [0.0, 0.0, 0.0], inputs, BOUC_WEN_S)
        write(tmp_path / name, inputs, read, BOUC_WEN_S, 1.0)
    figures, (finding,) = bouc_wen(tmp_path)
    assert finding.effects[0] == "hysteretic_spring"
    assert [figure.data for figure in figures] == ["Bouc-Wen"] * 4
    linear, diagnosed, linear_sweep, diagnosed_sweep = (
        figure.ours for figure in figures)
    assert 5.0 < linear < 40.0
    assert diagnosed < 0.2 * linear
    assert diagnosed_sweep < 0.2 * linear_sweep
