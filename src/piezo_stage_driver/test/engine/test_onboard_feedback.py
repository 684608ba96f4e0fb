# SPDX-License-Identifier: BSD-3-Clause
"""An uploaded law beside answers that are worked out in the test, and under every guard."""

from dataclasses import replace

import numpy as np
import pytest
from linear_stage_loop import (
    APPROACH_TICKS,
    TICK,
    LinearStage,
    begin,
    declared,
    engine_of,
    finish,
    integral_law,
    planned_v,
)

from piezo_models.feedback_law.feedback_law import (
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_stage_driver.engine.blocks import FLAG_STOPPED, FLAG_TRACKING
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import FeedbackOscillation
from piezo_stage_driver.safety.limits import (
    FLAG_RANGE_LIMITED,
    FeedbackLimits,
    VoltageLimits,
)


def integral_answers(engine, stage, rate=0.15):
    """Play with answers to blocks: the same integral, written out."""
    total_um, tick, blocks = 0.0, 0, []
    reference_um = stage.gain_um_per_v * planned_v()[0]
    while not engine.idle:
        block = engine.advance()
        blocks.append(block)
        if not block.flags & FLAG_TRACKING or engine.phase_name != "track":
            continue
        if tick >= APPROACH_TICKS:
            part = slice(tick * TICK, (tick + 1) * TICK)
            total_um += (reference_um[part] - block.displacement_um).mean()
        engine.answer(block.tick, rate / stage.gain_um_per_v * total_um)
        tick += 1
    return blocks


@pytest.mark.parametrize("lead_ticks", [0, 2])
def test_law_with_a_tick_of_delay_plays_what_answers_would_have_played(lead_ticks):
    stages = [LinearStage(lead_ticks=lead_ticks, offset_um=2.0) for _ in range(2)]
    rate = 0.15 / (1 + lead_ticks)
    remote = engine_of(stages[0])
    begin(remote, None, onboard=False)
    integral_answers(remote, stages[0], rate)
    onboard = engine_of(stages[1])
    begin(onboard, integral_law(stages[1], rate, delay_ticks=1))
    finish(onboard)
    played_v = [np.concatenate(stage.played_v) for stage in stages]
    assert remote.missed_feedback == onboard.missed_feedback == 0
    # As if the offset were played: the loop works.
    assert played_v[1][95 * TICK] == pytest.approx(28.0, abs=0.1)
    np.testing.assert_allclose(played_v[1], played_v[0][:len(played_v[1])], atol=1e-9)


def test_law_without_delay_is_a_tick_earlier_than_answers_can_be():
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage)
    begin(engine, integral_law(stage))
    blocks = finish(engine)
    tracking = [block for block in blocks if block.flags & FLAG_TRACKING]
    added_v = [block.voltage_v.mean() - 30.0 for block in tracking[APPROACH_TICKS:]]
    assert added_v[0] == pytest.approx(0.0, abs=1e-9)
    assert added_v[1] == pytest.approx(-0.15 * 2.0, abs=0.05)
    np.testing.assert_allclose(added_v, np.concatenate(
        [block.feedback_v for block in tracking[APPROACH_TICKS:]]), atol=1e-12)


def test_blocks_of_several_ticks_hold_the_same_samples_and_flags():
    played = []
    for samples_per_block in (1, 7 * TICK):
        stage = LinearStage(offset_um=2.0)
        engine = engine_of(stage, samples_per_block=samples_per_block)
        # At its end the feedforward leaves the range by the feedback, in some ticks.
        begin(engine, integral_law(stage))
        blocks = finish(engine)
        at = 0
        for block in blocks:
            assert block.first_sample == at and block.tick == (at + len(block.voltage_v)) // TICK
            at += len(block.voltage_v)
        played.append({
            name: np.concatenate([getattr(block, name) for block in blocks])
            for name in ("voltage_v", "displacement_um")} | {
            "flags": np.concatenate(
                [np.full(len(block.voltage_v), block.flags) for block in blocks]),
            "feedback_v": np.concatenate(
                [block.feedback_v for block in blocks if block.feedback_v is not None])})
        longest = max(len(block.voltage_v) for block in blocks)
        assert longest == max(TICK, samples_per_block)
    assert len(played[0]["feedback_v"]) == 100
    for name, values in played[0].items():
        np.testing.assert_array_equal(values, played[1][name])


def test_block_ends_where_the_flags_change():
    stage = LinearStage(offset_um=-2.0)
    engine = StageEngine(stage, VoltageLimits(-20.0, 31.0, 2e6), samples_per_tick=TICK,
                         samples_per_block=1000 * TICK)
    begin(engine, integral_law(stage))
    blocks = finish(engine)
    flags = [block.flags for block in blocks if block.flags & FLAG_TRACKING]
    assert len(set(flags)) == len(flags) == 2
    limited, = [block for block in blocks if block.flags == FLAG_TRACKING | FLAG_RANGE_LIMITED]
    assert (limited.voltage_v == 31.0).reshape(-1, TICK).any(axis=1).all()
    assert sum(len(block.voltage_v) for block in blocks) == engine.next_sample


@pytest.mark.parametrize("kind", ["tick", "sample"])
def test_a_law_leaves_the_end_of_the_amplifier_as_soon_as_the_error_turns(kind):
    """At 31 V the error cannot vanish; an integral that had summed it up would stay there."""
    stage = LinearStage(offset_um=-4.0)
    engine = StageEngine(stage, VoltageLimits(-20.0, 31.0, 2e6), samples_per_tick=TICK)
    quick = LinearBlock.of([1.0], [0.15 / TICK], [1.0], [0.0])
    begin(engine, integral_law(stage) if kind == "tick" else integral_law(
        stage, tick=LinearBlock(), observer=np.zeros(0), sample=quick))
    played_v = []
    for tick in range(100):
        if tick == 90:
            stage._offset_um = 1.0
        played_v.append(engine.advance().voltage_v.mean())
    assert played_v[89] == pytest.approx(31.0, abs=1e-9)
    # The integral of the 3 um that were left in some 50 ticks would be 22 V.
    assert played_v[99] < 30.5


@pytest.mark.parametrize("samples_per_block", [1, 50 * TICK])
def test_stop_in_the_midst_of_a_block_ramps_to_rest_and_loses_no_sample(samples_per_block):
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage, samples_per_block=samples_per_block)
    begin(engine, integral_law(stage), ticks=0)
    blocks = [engine.advance() for _ in range(60)]
    engine.stop("somebody stopped it")
    blocks = [block for block in blocks if block is not None] + finish(engine)
    assert sum(len(block.voltage_v) for block in blocks) == engine.next_sample
    assert engine.voltage_v == 0.0
    assert {bool(block.flags & FLAG_STOPPED) for block in blocks if block.flags & FLAG_TRACKING
            } == {False}
    assert np.abs(np.diff(np.concatenate(stage.played_v))).max() < 2.0


def test_law_that_replaces_another_goes_on_from_it():
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage)
    begin(engine, integral_law(stage), ticks=0)
    for _ in range(50):
        engine.advance()
    before_v = engine.voltage_v
    engine.commands.load_feedback(engine.commands.checked(integral_law(stage, 0.3)))
    engine.advance()
    assert abs(engine.voltage_v - before_v) < 0.05
    for _ in range(40):
        block = engine.advance()
    assert block.displacement_um.mean() == pytest.approx(30.0, abs=0.02)


def test_law_of_another_run_is_refused_within_a_run_which_goes_on():
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage)
    begin(engine, integral_law(stage), ticks=0)
    for _ in range(50):
        engine.advance()
    foreign = integral_law(stage, once_um=np.full(7, 60.0))
    with pytest.raises(FeedbackLawError, match="expects 7 and 0 displacements where 4000 and 0"):
        engine.commands.load_feedback(engine.commands.checked(foreign))
    for _ in range(40):
        block = engine.advance()
    assert block.displacement_um.mean() == pytest.approx(30.0, abs=0.02)


def test_law_of_another_reference_that_bounds_no_error_is_stopped_as_the_one_before():
    """Whoever uploads it within a run: it would lead the stage by 30 um to where nobody asked."""
    stage = LinearStage(offset_um=2.0)
    engine = engine_of(stage)
    law = integral_law(stage, max_error_um=4.0)
    begin(engine, law, ticks=0)
    for _ in range(50):
        engine.advance()
    foreign = integral_law(stage, once_um=law.once_um + 30.0)
    assert foreign.max_error_um == np.inf
    begun = engine.tick
    engine.commands.load_feedback(engine.commands.checked(foreign))
    while not engine.stop_cause:
        engine.advance()
    assert engine.tick - begun <= 2
    assert "has an error of 30 um" in engine.stop_cause
    assert "settle the stage (stage settle) and track again" in engine.stop_cause
    assert np.abs(np.concatenate(stage.displacement_um[begun:])).max() < 35.0


def test_law_at_the_sample_rate_acts_within_the_tick():
    stage = LinearStage(noise_um=0.0, offset_um=1.0)
    engine = engine_of(stage)
    law = integral_law(stage, sample=LinearBlock(d=0.2), start_sample=0)
    begin(engine, law)
    engine.advance()
    added_v = np.concatenate(stage.played_v) - planned_v()[0][:TICK]
    error_um = planned_v()[0][:TICK] - np.concatenate(stage.displacement_um)
    np.testing.assert_allclose(added_v[1:], 0.2 * error_um[:-1], atol=1e-12)


def test_answers_have_no_effect_beside_a_law():
    stage = LinearStage()
    engine = engine_of(stage)
    begin(engine, integral_law(stage))
    engine.advance()
    with pytest.raises(FeedbackError, match="takes no answers"):
        engine.answer(engine.tick, 3.0)
    assert not engine.awaiting_answer


def test_law_needs_a_feedforward_and_belongs_to_it():
    stage = LinearStage()
    engine = engine_of(stage)
    law = engine.commands.checked(integral_law(stage))
    with pytest.raises(StageRefusal, match="no feedforward is loaded"):
        engine.commands.load_feedback(law)
    engine.commands.load_feedforward(*planned_v())
    engine.commands.load_feedback(law)
    engine.commands.load_feedforward(*planned_v())
    with pytest.raises(StageRefusal, match="no feedback law is loaded for this feedforward"):
        engine.commands.start_tracking(False, 0, "", True)
    engine.commands.start_tracking(True)
    with pytest.raises(StageRefusal, match="busy"):
        engine.commands.load_feedback(law)


def test_law_is_refused_before_it_is_loaded():
    stage = LinearStage()
    engine = engine_of(stage)
    with pytest.raises(FeedbackLawError, match="not stable"):
        engine.commands.checked(integral_law(stage, rate=8.0))
    with pytest.raises(FeedbackLawError, match="more than this stage takes, 140 V"):
        engine.commands.checked(integral_law(stage, max_feedback_v=200.0))


def test_law_that_steps_too_far_in_a_row_stops_the_stage():
    stage = LinearStage(offset_um=8.0)
    engine = engine_of(stage, feedback_limits=FeedbackLimits(140.0, 0.2, 3))
    begin(engine, integral_law(stage), ticks=0)
    finish(engine)
    assert engine.stop_cause == "the feedback law stepped by more than 0.2 V in 4 ticks in a row"


def test_law_that_leaves_a_large_error_stops_the_stage():
    """A stage that slips by 6 um, as where its load falls off."""
    stage = LinearStage()
    engine = engine_of(stage)
    begin(engine, integral_law(stage, max_error_um=4.0), ticks=0)
    for _ in range(40):
        engine.advance()
    stage._offset_um = 6.0
    begun = engine.tick
    while not engine.stop_cause:
        engine.advance()
    assert engine.tick - begun <= 2
    assert "has an error of" in engine.stop_cause


@pytest.mark.parametrize("sample", [LinearBlock(), LinearBlock.of([0.9], [0.1], [0.3], [0.2])])
@pytest.mark.parametrize("through_inverse", [False, True])
def test_a_reading_that_is_no_number_stops_the_stage_and_reaches_no_amplifier(
        sample, through_inverse):
    stage = LinearStage(offset_um=1.0)
    engine = engine_of(stage)
    hysteresis = PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 1e-3)), 0.0,
                               np.full(20, 0.9))
    inverse = InverseHysteresis(hysteresis, 1.0) if through_inverse else None
    begin(engine, integral_law(stage, 0.05, sample=sample, inverse=inverse), ticks=0)
    for _ in range(40):
        engine.advance()
    stage._offset_um = np.nan
    finish(engine)
    assert "error of nan um" in engine.stop_cause
    assert np.isfinite(np.concatenate(stage.played_v)).all()
    assert engine.voltage_v == 0.0


def drawn_stage(rng):
    return LinearStage(10 ** rng.uniform(-1, 1), rng.uniform(300.0, 900.0), rng.uniform(0.2, 0.7),
                       noise_um=rng.uniform(0.001, 0.02), offset_um=rng.uniform(-3.0, 3.0),
                       seed=rng.integers(1 << 30))


def check_drawn_loop_of_another_gain(seed):
    """Check a law whose gain is many times too high, with the right model and with a wrong one."""
    rng = np.random.default_rng(seed)
    stage, factor = drawn_stage(rng), 10 ** rng.uniform(np.log10(12.0), np.log10(300.0))
    law = integral_law(stage, rng.uniform(0.3, 0.35), max_error_um=4.0)
    engine = engine_of(stage, feedback_guard=FeedbackOscillation(4.0))
    engine.commands.checked(law)
    loud = replace(law.tick, c=factor * law.tick.c, d=factor * law.tick.d)
    with pytest.raises(FeedbackLawError, match="is not stable|times as large"):
        engine.commands.checked(replace(law, tick=loud))
    # It declares a stage that moves by so much less.
    blind = replace(law, tick=loud, plant=declared(stage, stage.gain_um_per_v / factor))
    begin(engine, blind, ticks=0)
    twin = drawn_stage(np.random.default_rng(seed))
    while not engine.stop_cause and engine.tick < 100:
        engine.advance()
        twin.exchange(planned_v()[0][(engine.tick - 1) * TICK:engine.tick * TICK])
    late_ticks = engine.tick - APPROACH_TICKS
    deviation_um = np.abs(
        np.concatenate(stage.displacement_um) - np.concatenate(twin.displacement_um))[:-TICK].max()
    assert "design it for this stage" in engine.stop_cause, (seed, factor)
    assert late_ticks <= 3 and deviation_um < 5.0, (seed, factor, late_ticks, deviation_um)


@pytest.mark.parametrize("seed", range(12))
def test_loop_of_another_gain_is_refused_or_stopped(seed):
    check_drawn_loop_of_another_gain(seed)


@pytest.mark.long
def test_500_loops_of_another_gain_are_refused_or_stopped():
    for seed in range(500):
        check_drawn_loop_of_another_gain(seed)


def test_loop_of_the_right_gain_is_not_stopped():
    for seed in range(10):
        stage = drawn_stage(np.random.default_rng(seed))
        engine = engine_of(stage, feedback_guard=FeedbackOscillation(4.0))
        begin(engine, integral_law(stage, max_error_um=4.0))
        finish(engine)
        assert engine.stop_cause == "", seed
