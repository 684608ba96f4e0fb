# SPDX-License-Identifier: BSD-3-Clause
"""Inverses with a preview, against the response that they are to undo."""

import numpy as np
import pytest

from piezo_controller.feedforward.preview_inverse import METHODS, preview_inverse
from piezo_models.linear.dynamics import (
    ElectricVibrationDynamics,
    simulate_linear,
    zoh,
    zoh_response,
)

pytestmark = pytest.mark.kernels

SAMPLE_PERIOD_S = 25e-6
DYNAMICS = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992))
SYSTEM = DYNAMICS.state_space()
# Up to which frequency (Hz), and how far, the inverse may miss.
ACCURACY = {"least_squares": (2500.0, 2e-3), "zero_phase": (5000.0, 1e-4),
            "derivatives": (600.0, 5e-3)}


@pytest.mark.parametrize("method", METHODS)
def test_inverse_undoes_the_sampled_dynamics_in_its_band(method):
    highest_hz, largest = ACCURACY[method]
    frequency_hz = np.linspace(0.0, highest_hz, 200)
    inverse = preview_inverse(SYSTEM, SAMPLE_PERIOD_S, method)
    assert inverse.preview_samples <= 20
    undone = (inverse.response(frequency_hz, SAMPLE_PERIOD_S)
              * zoh_response(SYSTEM, frequency_hz, SAMPLE_PERIOD_S))
    assert np.abs(undone - 1.0).max() < largest
    assert undone[0] == pytest.approx(1.0, abs=1e-9)
    assert np.abs(np.roots(inverse.denominator)).max(initial=0.0) < 1.0


@pytest.mark.parametrize("method", METHODS)
def test_filter_gives_what_its_response_says_and_the_same_in_any_chunks(method):
    inverse = preview_inverse(SYSTEM, SAMPLE_PERIOD_S, method)
    time_s = np.arange(6000) * SAMPLE_PERIOD_S
    reference = 50.0 + np.sin(2 * np.pi * 300.0 * time_s)
    state = inverse.state(50.0)
    whole, _ = inverse.apply(reference, state)
    pieces = []
    for piece in np.split(reference, [1, 40, 1000, 1007]):
        filtered, state = inverse.apply(piece, state)
        pieces.append(filtered)
    np.testing.assert_allclose(np.concatenate(pieces), whole, rtol=1e-9)
    # What comes out at n belongs to n - preview.
    output = simulate_linear(zoh(SYSTEM, SAMPLE_PERIOD_S), whole)
    wanted = reference[:output.size - inverse.preview_samples]
    error = output[inverse.preview_samples:] - wanted
    assert np.abs(error[3000:]).max() < 1e-3


def test_zero_phase_inverse_has_the_phase_that_its_name_says():
    frequency_hz = np.linspace(10.0, 15000.0, 300)
    inverse = preview_inverse(SYSTEM, SAMPLE_PERIOD_S, "zero_phase")
    undone = (inverse.response(frequency_hz, SAMPLE_PERIOD_S)
              * zoh_response(SYSTEM, frequency_hz, SAMPLE_PERIOD_S))
    assert np.abs(np.angle(undone)).max() < 1e-6


def test_derivatives_of_a_noisy_reference_are_those_of_the_smooth_one_unlike_differences():
    generator = np.random.default_rng(1)
    time_s = np.arange(8000) * SAMPLE_PERIOD_S
    noise = 1e-3 * generator.standard_normal(time_s.size)
    amplified = {}
    for method in METHODS:
        inverse = preview_inverse(SYSTEM, SAMPLE_PERIOD_S, method)
        amplified[method] = np.std(inverse.apply(noise, inverse.state(0.0))[0][100:])
    assert amplified["derivatives"] < 3.0
    assert amplified["derivatives"] < 0.3 * amplified["least_squares"]
    assert amplified["least_squares"] < 0.01 * amplified["zero_phase"]


def test_preview_too_short_or_dynamics_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="unknown inversion 'magic'"):
        preview_inverse(SYSTEM, SAMPLE_PERIOD_S, "magic")
    with pytest.raises(ValueError, match=r"needs \d+ samples of preview, not 1"):
        preview_inverse(SYSTEM, SAMPLE_PERIOD_S, "zero_phase", 1)
    with pytest.raises(ValueError, match="gives no derivative of order 5"):
        preview_inverse(SYSTEM, SAMPLE_PERIOD_S, "derivatives", 2)
    notched = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.7, 0.08), (3500.0,), (0.1,))
    with pytest.raises(ValueError, match="antiresonances is no polynomial"):
        preview_inverse(notched.state_space(), SAMPLE_PERIOD_S, "derivatives")


ON_ANY_KERNEL = """
import numpy as np
from piezo_controller.feedforward.preview_inverse import METHODS, preview_inverse
from piezo_models.linear.dynamics import ElectricVibrationDynamics
system = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992)).state_space()
result = {}
for method in METHODS:
    inverse = preview_inverse(system, 25e-6, method)
    result[f"{method} taps"] = inverse.numerator
    result[f"{method} response"] = inverse.response(np.linspace(0.0, 3000.0, 100), 25e-6)
"""


@pytest.mark.long
def test_inverse_is_the_same_on_every_kernel_of_the_linear_algebra(under_each_kernel):
    results = under_each_kernel(ON_ANY_KERNEL)
    (_, first), *others = results.items()
    for kernel, result in others:
        for name, values in first.items():
            # The zero-phase taps sum to 1 from terms of 1e7, which leaves nine digits.
            tolerance = 1e-11 if name.startswith("derivatives") else 1e-8
            difference = np.abs(result[name] - values).max() / np.abs(values).max()
            assert difference < tolerance, f"{name}, {kernel}"
