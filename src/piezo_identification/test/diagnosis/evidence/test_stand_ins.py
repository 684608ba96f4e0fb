# SPDX-License-Identifier: BSD-3-Clause
"""What fits but cannot be believed is marked, and has no interval."""

import pytest

from piezo_identification.diagnosis.evidence.effect_entries import name_of, with_stand_ins
from piezo_models.effects import Extent
from piezo_models.effects.delay import Delay
from piezo_models.effects.gain_drift import GainDrift

EXTENT = Extent(10.0, 0.0, 100.0, 2.0, 1e-3)


@pytest.mark.parametrize(("time_constant_s", "probability", "is_marked"), [
    (0.5, 0.9, False), (20.0, 0.9, True), (0.5, 1e-8, True)])
def test_an_effect_at_its_bound_or_of_tiny_probability_is_a_stand_in(
        time_constant_s, probability, is_marked):
    effect = GainDrift(0.1, time_constant_s, 0.0)
    entry = {"name": effect.name, "parameters": effect.parameters(),
             "standard_deviations": {"change": 0.01}}
    shares = {"gain_drift": probability, "something_else": 1.0 - probability}
    (found,) = with_stand_ins([entry], EXTENT, shares)
    assert found.get("stand_in", False) is is_marked
    assert ("standard_deviations" in found) is not is_marked
    assert name_of(found).startswith("what behaves like") is is_marked


def test_a_delay_is_no_stand_in_because_the_recording_is_long():
    delay = Delay(1e-4)
    entry = {"name": delay.name, "parameters": delay.parameters(), "standard_deviations": {}}
    long = Extent(10.0, 0.0, 100.0, 28.0, 1e-3)
    assert with_stand_ins([entry], long, {"delay": 0.9}) == [entry]
