# SPDX-License-Identifier: BSD-3-Clause
"""Poles below the lowest resonance are left out where hysteresis and creep stand for them."""

import numpy as np

from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.modes_fit import without_slow_poles

RATE_HZ = 40_000.0


def numbers_of(*modes):
    """Return the numbers of light modes and a real pole: frequency, damping ratio, static gain."""
    rates = np.array([2.0 * np.pi * hz * (1j * np.sqrt(1.0 - zeta**2) - zeta)
                      for hz, zeta, _ in modes])
    steps = np.exp(rates / RATE_HZ)
    steps.imag[np.abs(steps.imag) < 1e-12] = 0.0
    gains = []
    for step, (*_, static) in zip(steps, modes, strict=True):
        matrix = static * np.array([[1.0, -0.02], [-0.03, 0.9]])
        if step.imag:  # without a real part, so that 2 Re(R / (1 - step)) is the static gain
            residue = 1j * matrix / (2.0 * (1j / (1.0 - step)).real)
            gains += [residue.real, residue.imag]
        else:
            gains.append(matrix * (1.0 - step.real))
    none = np.zeros((0, len(gains), 2, 2))
    return CoupledNumbers(steps, np.array(gains), np.zeros((2, 2, 2)), none, none[:, 0], 1.0,
                          np.ones(len(gains)))


def frequencies_hz(numbers):
    return np.abs(np.log(numbers.steps)) * RATE_HZ / (2.0 * np.pi)


def test_light_poles_that_do_not_resonate_are_not_the_lowest_resonance():
    numbers = numbers_of((702.0, 0.02, 0.001), (307.0, 0.012, 0.3), (5.9, 0.017, 0.001),
                         (1.5, 0.04, -0.018), (11.0, 1.0, -0.014))
    kept = without_slow_poles(numbers)
    np.testing.assert_allclose(frequencies_hz(kept), [702.0, 307.0], rtol=1e-6)
    assert 270.0 < kept.slowest * RATE_HZ / (2.0 * np.pi) < 280.0


def test_a_slow_stage_keeps_the_mode_at_which_it_resonates():
    numbers = numbers_of((702.0, 0.02, 0.001), (5.9, 0.017, 0.3), (1.0, 1.0, 0.01))
    np.testing.assert_allclose(frequencies_hz(without_slow_poles(numbers)), [702.0, 5.9], rtol=1e-6)
