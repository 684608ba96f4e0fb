# SPDX-License-Identifier: BSD-3-Clause
"""What a fit may make of an effect follows the recording, on whatever scale of time it was made."""

import numpy as np
import pytest

from piezo_models.effects import (
    Evidence,
    Extent,
    fitted_values,
    known_effects,
    with_fitted_values,
)
from piezo_models.linear.dynamics import ElectricVibrationDynamics

ROWS = 2000
PERIODS_S = (1e-7, 500.0, *(pytest.param(each, marks=pytest.mark.long) for each in (2.5e-5, 1.2)))


def reduction_of(residual_um):
    def reduction(contributions, positive=False):
        gains = np.linalg.lstsq(contributions, residual_um, rcond=None)[0]
        if positive:
            gains = np.maximum(gains, 0.0)
        left = residual_um - contributions @ gains
        return gains, 1.0 - float(left @ left) / float(residual_um @ residual_um)

    return reduction


def evidence_of(period_s):
    """The same cycles at another sample clock, a model that is late, drifts and lacks a mode."""
    rows = np.arange(ROWS)
    voltage_v = 50.0 - 50.0 * np.cos(2.0 * np.pi * rows / 200.0) + 5.0 * (rows % 400 > 300)
    displacement_um = 0.2 * voltage_v
    residual_um = (0.2 * np.roll(voltage_v, 3) - displacement_um + 1e-3 * rows
                   + 0.3 * np.sin(0.4 * rows) + np.random.default_rng(1).normal(0.0, 0.01, ROWS))
    # A mode of 20 rows, damped far more than any that swings.
    dynamics = ElectricVibrationDynamics(
        2.0 * period_s, (0.3 / period_s, 0.1 / period_s), (0.02, 30.0))
    return Evidence(period_s, voltage_v, displacement_um, residual_um, 0.01, dynamics,
                    displacement_um, reduction_of(residual_um), lambda signal: 1.0,
                    displacement_um + residual_um)


@pytest.mark.parametrize("period_s", PERIODS_S)
@pytest.mark.parametrize("kind", known_effects().values(), ids=lambda kind: kind.name)
def test_no_sample_clock_leads_to_a_number_that_is_refused(kind, period_s):
    evidence = evidence_of(period_s)
    extent = Extent(evidence.travel_um, float(evidence.voltage_v.min()),
                    float(evidence.voltage_v.max()), evidence.duration_s, period_s)
    for start in kind.starts(evidence):
        values, low, high = fitted_values(start, extent)
        assert (low < high).all()
        assert (values >= low).all() and (values <= high).all()
        for numbers in (values, low, high):
            finite = np.where(np.isfinite(numbers), numbers, values)
            assert fitted_values(with_fitted_values(start, finite), extent)[0] == pytest.approx(
                finite, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kind", known_effects().values(), ids=lambda kind: kind.name)
def test_the_bounds_of_a_recording_scale_with_its_clock(kind):
    seconds, slow = (kind.bounds(Extent(20.0, 0.0, 100.0, 2000.0 * period_s, period_s))
                     for period_s in (1.0, 1000.0))
    power = {"s": 1.0, "Hz": -1.0, "rad/s": -1.0, "um/s": -1.0, "V/s": -1.0}
    for name, bounds in seconds.items():
        factor = 1000.0 ** power.get(kind.units()[name], 0.0)
        assert slow[name] == pytest.approx(tuple(factor * bound for bound in bounds))
