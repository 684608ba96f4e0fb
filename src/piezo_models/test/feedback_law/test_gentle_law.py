# SPDX-License-Identifier: BSD-3-Clause
"""A law begins gently wherever the stage is, and what the amplifier cuts off does not wind it up.

The expected voltages come from the difference equations of the laws, by SciPy.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    LinearBlock,
)
from piezo_models.feedback_law.running_law import RunningLaw

SAMPLES, FADE = 10, 200
NUMERATOR, DENOMINATOR = [3.0, -4.4, 1.5], [1.0, -1.7, 0.7]
# Its controllable canonical form, with an integration.
BLOCK = LinearBlock.of([[1.7, -0.7], [1.0, 0.0]], [1.0, 0.0], [0.7, -0.6], [3.0])
PLANT = DeclaredPlant(LinearBlock.of([0.8], [0.2], [1.0], [0.0]), np.ones(1))
START, ERROR_UM, LENGTH = 20, 7.0, 600


def law_of(kind, start=START, **changes):
    blocks = {"sample": BLOCK} if kind == "sample" else {"tick": BLOCK}
    law = FeedbackLaw(**{"tick": LinearBlock(), "sample": LinearBlock(), **blocks},
                      observer=np.zeros(2 if kind == "tick" else 0), max_feedback_v=1e6,
                      once_um=np.zeros(1), period_um=np.zeros(0), plant=PLANT,
                      start_sample=start, fade_samples=FADE)
    return replace(law, **changes)


def played(law, displacement_um):
    """Return the voltages of a law for displacements that do not depend on them."""
    running = RunningLaw(law, SAMPLES)
    count, given_v = running.samples_at_once, []
    for part_um in displacement_um.reshape(-1, count):
        given_v.append(running.begin(np.zeros(count)).copy())
        running.take(part_um)
    return np.concatenate(given_v)


def minimum_jerk(samples):
    x = np.clip(np.arange(samples) / FADE, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def moving_um(seed=2):
    drawn = np.random.default_rng(seed).normal(size=LENGTH)
    motion_um = 0.05 * np.cumsum(drawn) * (np.arange(LENGTH) >= START)
    return -ERROR_UM + motion_um


@pytest.mark.parametrize("kind", ["sample", "tick"])
@pytest.mark.parametrize("start", [0, START])
def test_the_error_in_which_a_law_begins_is_faded_in(kind, start):
    """The law answers the error less what is left of that of its beginning."""
    displacement_um = moving_um()
    given_v = played(law_of(kind, start), displacement_um)
    initial_um = ERROR_UM if start else -displacement_um[0]
    seen_um = -displacement_um[start:] - initial_um * (1 - minimum_jerk(LENGTH - start))
    if kind == "tick":
        answers_v = lfilter(NUMERATOR, DENOMINATOR, seen_um.reshape(-1, SAMPLES).mean(axis=1))
        expected_v, late = np.repeat(answers_v, SAMPLES), SAMPLES
    else:
        expected_v, late = lfilter(NUMERATOR, DENOMINATOR, seen_um), 1
    assert not given_v[:start + late].any()
    np.testing.assert_allclose(
        given_v[start + late:], expected_v[:LENGTH - start - late], atol=1e-8)


@pytest.mark.parametrize("kind", ["sample", "tick"])
def test_a_law_begins_without_a_step_wherever_the_stage_rests(kind):
    displacement_um = np.full(LENGTH, -ERROR_UM)
    given_v = played(law_of(kind), displacement_um)
    at_once_v = played(law_of(kind, fade_samples=0), displacement_um)
    # All at once the direct part alone gives 21 V; faded in, it is an integral of a smooth rise.
    assert np.abs(np.diff(at_once_v)).max() >= 3.0 * ERROR_UM * 0.99
    assert np.abs(np.diff(given_v)[:START + FADE // 4]).max() < 0.3 * ERROR_UM


def test_a_law_that_takes_over_within_the_fade_goes_on_with_it():
    displacement_um = moving_um()
    alone_v = played(law_of("sample"), displacement_um)
    running, given_v = RunningLaw(law_of("sample"), SAMPLES), []
    for sample, value_um in enumerate(displacement_um):
        if sample == START + FADE // 2:
            following = RunningLaw(law_of("sample", fade_samples=0), SAMPLES)
            following.take_over(running)
            running = following
        given_v.append(running.begin(np.zeros(1))[0])
        running.take(np.array([value_um]))
    np.testing.assert_allclose(given_v, alone_v, atol=1e-9)


def test_a_negative_fade_is_refused():
    with pytest.raises(FeedbackLawError, match="fade_samples is -1: give 0 or more"):
        law_of("sample", fade_samples=-1)


@pytest.mark.parametrize("kind", ["sample", "tick"])
@pytest.mark.parametrize("corrected", [True, False])
def test_what_the_amplifier_cuts_off_does_not_wind_a_law_up(kind, corrected):
    """A plant of gain 1 whose amplifier ends at 2 V: an integral must leave the end at once."""
    integral = LinearBlock.of([1.0], [0.05], [1.0], [0.05])
    law = law_of(kind, 0, fade_samples=0, **{kind: integral},
                 observer=np.full(1 if kind == "tick" else 0, 0.5))
    running, state_um, offset_um, given_v = RunningLaw(law, SAMPLES), 0.0, -5.0, []
    count = running.samples_at_once
    for sample in range(0, 8000, count):
        if sample == 6000:
            offset_um = -1.0
        wanted_v = running.begin(np.zeros(count)).copy()
        played_v = np.clip(wanted_v, -2.0, 2.0)
        if corrected and (played_v != wanted_v).any():
            running.correct((played_v - wanted_v).mean())
            assert running.voltage_v == pytest.approx(played_v.mean())
        part_um = np.empty(count)
        for i, value_v in enumerate(played_v):
            part_um[i] = state_um + offset_um
            state_um = 0.8 * state_um + 0.2 * value_v
        running.take(part_um)
        given_v += list(played_v)
    assert given_v[5999] == 2.0
    if corrected:
        assert given_v[-1] == pytest.approx(1.0, abs=0.05)
    else:
        assert given_v[-1] == 2.0


def test_nothing_is_corrected_before_a_law_begins():
    running = RunningLaw(law_of("sample"), SAMPLES)
    running.begin(np.zeros(1))
    running.correct(-3.0)
    assert running.voltage_v == 0.0
    running.take(np.zeros(1))
    assert not running.begin(np.zeros(1)).any()
