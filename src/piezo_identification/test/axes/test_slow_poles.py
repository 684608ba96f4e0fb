# SPDX-License-Identifier: BSD-3-Clause
"""Poles below the lowest resonance are left out where hysteresis and creep stand for them."""

import numpy as np

from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.modes_fit import without_slow_poles
from piezo_identification.axes.spectra import response_to

RATE_HZ = 40_000.0


def spectra_of(duration_s):
    """Return a response at the lowest lines of recordings of some duration."""
    lines = np.arange(1.0, 50.0)
    z = np.exp(2j * np.pi * lines / (duration_s * RATE_HZ))
    return [response_to(0, z, np.zeros((lines.size, 2), complex), np.ones((lines.size, 2)), 1.0)]


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
    kept = without_slow_poles(numbers, spectra_of(10.0))
    np.testing.assert_allclose(frequencies_hz(kept), [702.0, 307.0], rtol=1e-6)
    assert 270.0 < kept.slowest * RATE_HZ / (2.0 * np.pi) < 280.0


def test_a_slow_stage_keeps_the_mode_at_which_it_resonates():
    numbers = numbers_of((702.0, 0.02, 0.001), (5.9, 0.017, 0.3), (1.0, 1.0, 0.01))
    kept = without_slow_poles(numbers, spectra_of(2.0))
    np.testing.assert_allclose(frequencies_hz(kept), [702.0, 5.9], rtol=1e-6)


def test_a_light_pole_of_few_periods_is_not_the_lowest_resonance():
    numbers = numbers_of((702.0, 0.02, 0.3), (5.9, 0.017, 0.3))
    kept = without_slow_poles(numbers, spectra_of(0.4))
    np.testing.assert_allclose(frequencies_hz(kept), [702.0], rtol=1e-6)
