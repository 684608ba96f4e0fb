# SPDX-License-Identifier: BSD-3-Clause
"""A feedforward and its law take the place of others between two ticks of a run, or not at all."""

from dataclasses import replace

import numpy as np
import pytest
from linear_stage_loop import (
    TICK,
    LinearStage,
    begin,
    engine_of,
    finish,
    integral_law,
    planned_v,
)

from piezo_models.feedback_law.feedback_law import FeedbackLawError
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.sources import FadeOver, Hold
from piezo_stage_driver.safety.limits import LimitError

BEFORE_TICKS, AFTER_TICKS = 50, 60
LARGER = 1.02


def larger_v():
    """Return the feedforward for a model whose gain is lower by 2 %."""
    once_v, period_v = planned_v()
    return LARGER * once_v, period_v


@pytest.mark.parametrize("lead_ticks", [0, 2])
@pytest.mark.parametrize("onboard", [True, False])
def test_voltage_goes_over_without_a_step_and_the_law_with_it(onboard, lead_ticks):
    stage = LinearStage(offset_um=2.0, noise_um=0.0, lead_ticks=lead_ticks)
    engine = engine_of(stage)
    if onboard:
        begin(engine, integral_law(stage), ticks=0)
    else:
        begin_without_feedback(engine)
    for _ in range(BEFORE_TICKS):
        engine.advance()
    law = integral_law(stage, 0.3) if onboard else None
    first_tick = engine.commands.replace_feedforward(
        engine.commands.replacement(*larger_v(), law))
    assert first_tick == engine.tick == BEFORE_TICKS
    for _ in range(AFTER_TICKS if onboard else AFTER_TICKS // 2):
        engine.advance()
    played_v = np.concatenate(stage.played_v)
    around_v = played_v[(first_tick - 1) * TICK:(first_tick + 1) * TICK]
    difference_v = (LARGER - 1.0) * planned_v()[0].max()
    assert np.abs(np.diff(around_v)).max() < 0.05 * difference_v
    if not onboard:
        np.testing.assert_allclose(played_v[-TICK:], larger_v()[0][:TICK].size * [30 * LARGER])
        return
    # What the feedforward gives more, the integral takes back: the reference is kept.
    assert stage.displacement_um[-1].mean() == pytest.approx(30.0, abs=0.02)
    assert engine.stop_cause == ""


def begin_without_feedback(engine):
    engine.commands.load_feedforward(*planned_v())
    engine.commands.start_tracking(False)


def test_way_from_one_source_to_another_is_smooth_and_ends_at_the_other():
    fade = FadeOver(Hold(10.0), Hold(20.0), 100)
    played_v = np.concatenate([fade.take(40) for _ in range(4)])
    assert played_v[0] == 10.0 and (played_v[100:] == 20.0).all()
    steps_v = np.diff(played_v)
    assert steps_v.min() >= 0.0
    # A minimum-jerk way is at most 15/8 times as fast as a straight line.
    assert steps_v.max() < 15 / 8 * 10 / 100 * (1 + 1e-3)
    assert np.abs(np.diff(steps_v)).max() < 10 * 5.8 / 100**2


def run_with_law():
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage)
    begin(engine, integral_law(stage), ticks=0)
    for _ in range(BEFORE_TICKS):
        engine.advance()
    return stage, engine


def test_what_is_refused_leaves_the_voltages_of_a_run_that_was_never_asked():
    stage, engine = run_with_law()
    twin, twins_engine = run_with_law()
    commands, law = engine.commands, integral_law(stage)
    with pytest.raises(FeedbackLawError, match="not stable"):
        commands.replacement(*larger_v(), integral_law(stage, rate=8.0))
    with pytest.raises(LimitError):
        commands.replacement(5 * planned_v()[0], [], law)
    short = commands.replacement(planned_v(90)[0], [], law)
    with pytest.raises(StageRefusal, match="has 3600 and 0 samples where 4000 and 0 play"):
        commands.replace_feedforward(short)
    with pytest.raises(StageRefusal, match="replace both, or neither"):
        commands.replace_feedforward(commands.replacement(*larger_v(), None))
    for one in (engine, twins_engine):
        for _ in range(AFTER_TICKS):
            one.advance()
    np.testing.assert_array_equal(np.concatenate(stage.played_v), np.concatenate(twin.played_v))


def test_nothing_is_replaced_where_nothing_tracks_or_a_node_answers():
    stage = LinearStage()
    engine = engine_of(stage)
    commands = engine.commands
    replacement = commands.replacement(*larger_v(), None)
    with pytest.raises(StageRefusal, match=r"does not track \(rest\)"):
        commands.replace_feedforward(replacement)
    commands.play([10.0, 20.0], 25e-6, 400)
    with pytest.raises(StageRefusal, match=r"does not track \(approach\)"):
        commands.replace_feedforward(replacement)
    finish(engine)
    commands.load_feedforward(*planned_v())
    commands.start_tracking(True)
    with pytest.raises(StageRefusal, match="between two runs"):
        commands.replace_feedforward(replacement)


def test_run_after_a_replacement_begins_with_it():
    stage, engine = run_with_law()
    law = integral_law(stage, 0.3)
    engine.commands.replace_feedforward(engine.commands.replacement(*larger_v(), law))
    for _ in range(AFTER_TICKS // 2):
        engine.advance()
    engine.commands.stop_tracking()
    finish(engine)
    before = len(stage.played_v)
    engine.commands.start_tracking(False, 0, "", True)
    engine.advance()
    np.testing.assert_allclose(stage.played_v[before], larger_v()[0][:TICK])


def test_replacement_that_follows_another_begins_where_that_one_is():
    stage, engine = run_with_law()
    for factor in (1.05, 0.95):
        law = replace(integral_law(stage), max_feedback_v=15.0)
        once_v, period_v = planned_v()
        engine.commands.replace_feedforward(
            engine.commands.replacement(factor * once_v, period_v, law))
        for _ in range(8):  # less than the way takes
            engine.advance()
    played_v = np.concatenate(stage.played_v)[BEFORE_TICKS * TICK - 1:]
    assert np.abs(np.diff(played_v)).max() < 0.01 * 30.0
