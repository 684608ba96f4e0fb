# SPDX-License-Identifier: BSD-3-Clause
"""The parameters that come nearest to a hidden effect, where they are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_models.effects import Extent
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.periodic_disturbance import PeriodicDisturbance
from piezo_studies.diagnosis_benchmark.coverage import nearest_parameters

PERIOD_S, SAMPLES = 1e-3, 4000
TIME_S = np.arange(SAMPLES) * PERIOD_S
DRIVE_UM = 5.0 * np.sin(2.0 * np.pi * 1.5 * TIME_S)


def regression():
    """Return what weighs all rows alike, with the offset as the only regressor."""
    return SimpleNamespace(
        dataset=SimpleNamespace(
            rows=(np.arange(SAMPLES),), extent=Extent(10.0, 0.0, 100.0, SAMPLES * PERIOD_S,
                                                      PERIOD_S)),
        tolerance_um=0.01, remainder=lambda difference: difference - difference.mean())


def test_an_effect_of_the_same_form_is_found_as_it_is():
    added_um = Backlash(0.4).apply(DRIVE_UM, PERIOD_S) - DRIVE_UM
    nearest = nearest_parameters(Backlash(0.3), DRIVE_UM, added_um, PERIOD_S, regression())
    assert nearest["width_um"] == pytest.approx(0.4, rel=1e-4)


def test_a_hum_that_wandered_has_the_frequency_that_it_had():
    phase = 2.0 * np.pi * 50.0 * TIME_S + 0.3 * TIME_S / TIME_S[-1] + 0.2
    nearest = nearest_parameters(
        PeriodicDisturbance(50.0, 0.05, 0.05), DRIVE_UM, 0.1 * np.sin(phase), PERIOD_S,
        regression())
    gained_hz = 0.3 / (2.0 * np.pi * TIME_S[-1])
    assert nearest["frequency_hz"] - 50.0 == pytest.approx(gained_hz, rel=1e-3)
