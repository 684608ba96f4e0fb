# SPDX-License-Identifier: BSD-3-Clause
"""Each kind of waveform is told by its voltage alone, measured or ideal, from any start."""

import numpy as np
import pytest
from scipy.signal import chirp, lfilter, sawtooth

from piezo_identification.recording_check.waveform_kind import waveform_of

PERIOD_S = 1e-3
TIME_S = PERIOD_S * np.arange(20_000)


def multisine(random):
    lines = np.arange(1, 200)
    phase = random.uniform(0, 2 * np.pi, lines.size)
    once = np.cos(2 * np.pi * np.outer(np.arange(4000), lines) / 4000 + phase).sum(axis=1)
    return np.tile(once, 5)


def rising_staircase(random):
    """Way up and down in steps, each a tenth of the range higher than the one before."""
    turns = np.concatenate([[0.0, top] for top in np.arange(1, 11) / 10.0] + [[0.0]])
    ways = [np.arange(low, high, 0.02 * np.sign(high - low))
            for low, high in zip(turns[:-1], turns[1:], strict=True)]
    return np.repeat(np.concatenate(ways), 10)


def dithered_sine(random):
    """Growing sine with small steps on top, as laboratories excite hysteresis and vibration."""
    return TIME_S * np.sin(2.0 * np.pi * 0.7 * TIME_S) + np.repeat(random.normal(size=400), 50)


MAKERS = {
    "constant": lambda random: np.full(TIME_S.size, 20.0),
    "square": lambda random: np.sign(np.sin(2 * np.pi * (TIME_S + random.uniform(0.0, 2.0)) / 1.9)),
    "steps": lambda random: np.repeat(random.choice(np.linspace(0, 1, 8), 40), 500),
    "triangle": lambda random: sawtooth(2 * np.pi * TIME_S / 2.3 + random.uniform(0, 6), 0.5),
    "sine": lambda random: np.sin(2 * np.pi * 0.7 * TIME_S + random.uniform(0, 6)),
    "cycles": lambda random: (1 + np.floor(TIME_S / 2.0)) * (1 - np.cos(np.pi * TIME_S)),
    "cycles of rising steps": rising_staircase,
    "cycles of a sine that grows": lambda random: TIME_S * np.sin(
        2 * np.pi * 0.7 * TIME_S + random.uniform(0, 6)),
    "cycles of a sine that grows, with a dither": dithered_sine,
    "cycles of a sine that decays": lambda random: np.exp(-0.1 * TIME_S) * np.sin(
        2 * np.pi * TIME_S + random.uniform(0, 6)),
    "multisine": multisine,
    "noise": lambda random: lfilter([1.0], [1.0, -0.9], random.normal(size=TIME_S.size)),
    "noise of two levels behind an amplifier": lambda random: lfilter(
        [0.5], [1.0, -0.5], np.repeat(random.choice([-1.0, 1.0], TIME_S.size // 5), 5)),
    "chirp": lambda random: chirp(TIME_S, 0.5, TIME_S[-1], 60.0, phi=random.uniform(0, 360)),
}


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_kind_is_told(kind, seed, noise):
    random = np.random.default_rng(seed)
    voltage_v = 50.0 + 40.0 * np.asarray(MAKERS[kind](random), dtype=float)
    noise_v = noise * (np.ptp(voltage_v) or 5.0)
    voltage_v = voltage_v + noise_v * random.normal(size=voltage_v.size)
    assert waveform_of(voltage_v, PERIOD_S).kind == kind.split()[0]


def test_jumps_period_and_time_between_reversals_are_measured():
    square = waveform_of(np.where(TIME_S % 4.0 < 2.0, 80.0, 20.0), PERIOD_S)
    assert square.branch_s == pytest.approx(2.0)
    assert square.jumps.tolist() == list(range(2000, 20_000, 2000))
    sine = waveform_of(np.sin(2 * np.pi * TIME_S / 0.8), PERIOD_S)
    assert sine.branch_s == pytest.approx(0.4, rel=0.01)
    assert sine.period == 800
    twice = waveform_of(sawtooth(2 * np.pi * TIME_S / 10.0, 0.5), PERIOD_S)
    assert twice.period == 10_000
    swept = waveform_of(chirp(TIME_S, 2.0, TIME_S[-1], 40.0), PERIOD_S)
    low, high = (float(word) for word in swept.text.removesuffix(" Hz").split(" to "))
    assert low == pytest.approx(2.0, rel=0.5) and high == pytest.approx(40.0, rel=0.1)


@pytest.mark.parametrize("amplitude, words", [
    (TIME_S, "amplitude grows"), (np.floor(TIME_S / 2.0) + 1.0, "amplitude grows"),
    (np.maximum(TIME_S - 4.0, 0.0), "amplitude grows"),
    (np.exp(-0.1 * TIME_S), "amplitude shrinks")])
def test_a_sine_whose_amplitude_changes_says_so_and_has_neither_period_nor_jumps(amplitude, words):
    found = waveform_of(amplitude * np.sin(2.0 * np.pi * TIME_S), PERIOD_S)
    assert found.text == f"a sine of 1 Hz whose {words}"
    assert found.period == 0 and found.jumps.size == 0


def test_steps_of_a_dither_are_no_jumps_but_one_that_stands_out_is():
    for seed in range(10):
        random = np.random.default_rng(seed)
        assert waveform_of(dithered_sine(random), PERIOD_S).jumps.size == 0
        after_rest_v = np.append(np.zeros(1000), 40.0 * np.sin(4.4 * TIME_S + 1.0))
        after_rest_v += np.repeat(random.normal(scale=0.5, size=420), 50)
        found = waveform_of(after_rest_v, PERIOD_S)
        assert found.kind == "sine" and found.jumps.tolist() == [1000]


def test_levels_are_counted_where_they_are_apart():
    random = np.random.default_rng(2)
    for levels, words in ((MAKERS["steps"](random), " over 8 levels"),
                          (np.repeat(random.uniform(size=40), 500), " steps, held for 0.5 s")):
        assert words in waveform_of(levels, PERIOD_S).text


def test_a_sine_with_short_steps_is_no_square_wave():
    """Its steps are held for five rows, in which the sine hardly moves; outliers leave a gap."""
    random = np.random.default_rng(7)
    time_s = 1e-4 * np.arange(15_000)
    voltage_v = 40.0 * time_s * np.sin(2.0 * np.pi * 5.0 * time_s) + 4.0 * np.repeat(
        random.normal(size=3000), 5)
    assert waveform_of(voltage_v, 1e-4).kind == "cycles"


def test_points_of_a_single_loop_have_a_kind():
    points_v = np.concatenate([np.linspace(0.0, 100.0, 21), np.linspace(95.0, 0.0, 20)])
    assert waveform_of(points_v, 2.0).kind == "triangle"
    assert waveform_of(50.0 - 50.0 * np.cos(np.pi * points_v / 50.0), 2.0).kind != "constant"
