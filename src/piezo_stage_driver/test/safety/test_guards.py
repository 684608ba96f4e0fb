# SPDX-License-Identifier: BSD-3-Clause
"""Each guard stops what it is there for, soon enough, and lets pass what a sound stage does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from piezo_stage_driver.engine.blocks import FLAG_STOPPED
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import (
    FeedbackOscillation,
    SensorNoise,
    SensorRange,
    SensorResponse,
    StopLatch,
    Stretch,
)
from piezo_stage_driver.safety.limits import VoltageLimits

TICK = 40
PERIOD_S = 1 / 40000.0


def examined(guard, voltage_v, displacement_um, stretch=TICK, tick=TICK):
    """Show a guard samples; return its cause and the sample at which it told, or None."""
    for at in range(0, len(displacement_um), stretch):
        part = slice(at, at + stretch)
        cause = guard.examine(Stretch.of(voltage_v[part], displacement_um[part], tick))
        if cause:
            return cause, at + stretch
    return None


def sound_stage(voltage_v, seed=0, noise_um=0.009):
    """Return a lag of 0.5 ms, a gain of 1 um/V, noise."""
    pole = np.exp(-PERIOD_S / 5e-4)
    displacement_um = lfilter([0.0, 1.0 - pole], [1.0, -pole], voltage_v)
    return displacement_um + noise_um * np.random.default_rng(seed).standard_normal(len(voltage_v))


def every_guard():
    return [SensorRange(-45.0, 145.0), SensorResponse(), SensorNoise(0.2)]


@pytest.mark.parametrize("stretch", [TICK, 4000])
@pytest.mark.parametrize("frequency_hz", [0.5, 20.0, 400.0, 5000.0])
def test_sound_stage_is_let_pass_at_every_frequency(frequency_hz, stretch):
    time_s = np.arange(40_000) * PERIOD_S
    voltage_v = 50.0 + 50.0 * np.sin(2 * np.pi * frequency_hz * time_s)
    for guard in every_guard():
        assert examined(guard, voltage_v, sound_stage(voltage_v), stretch) is None


def test_square_waves_and_single_glitches_are_let_pass():
    voltage_v = np.tile(np.repeat([80.0, 30.0], 400), 50)
    displacement_um = sound_stage(voltage_v)
    displacement_um[500::997] += 300.0
    for guard in every_guard():
        assert examined(guard, voltage_v, displacement_um) is None


def test_reading_that_is_no_number_is_told_in_its_tick():
    for value in (np.nan, np.inf, -np.inf):
        displacement_um = np.zeros(4000)
        displacement_um[2010] = value
        told = examined(SensorRange(-45.0, 145.0), np.zeros(4000), displacement_um)
        assert told == ("the sensor's reading is not a number", 2040)


@pytest.mark.parametrize("reading_um", [-46.0, 150.0])
def test_reading_out_of_range_is_told_within_a_tick(reading_um):
    displacement_um = np.zeros(4000)
    displacement_um[2010:] = reading_um
    cause, at = examined(SensorRange(-45.0, 145.0), np.zeros(4000), displacement_um)
    assert cause == f"the sensor reads {reading_um:g} um, outside [-45, 145] um"
    assert at == 2040


@pytest.mark.parametrize("noise_um", [0.0, 0.009])
def test_stuck_sensor_is_told_20_ms_after_20_volts(noise_um):
    voltage_v = 50.0 * (1.0 - np.cos(2 * np.pi * 5.0 * np.arange(8000) * PERIOD_S))
    stuck_um = sound_stage(np.full(8000, 30.0), noise_um=noise_um)
    stuck_um[:200] = stuck_um[200]
    cause, at = examined(SensorResponse(20.0, 0.4), voltage_v, stuck_um)
    moved = np.flatnonzero(voltage_v > 20.0)[0]
    assert cause.startswith("the sensor is stuck")
    assert moved < at <= moved + 880


def test_still_stage_with_a_still_sensor_is_let_pass():
    voltage_v = 5.0 + 9.0 * np.sin(np.arange(80_000) * 0.001)
    assert examined(SensorResponse(20.0, 0.4), voltage_v, np.zeros(80_000)) is None


@pytest.mark.parametrize("tick", [1, 40])
def test_noise_far_above_normal_is_told_within_20_ms(tick):
    voltage_v = 50.0 + 50.0 * np.sin(np.arange(8000) * 0.05)
    displacement_um = sound_stage(voltage_v)
    assert examined(SensorNoise(0.2), voltage_v, displacement_um, tick, tick) is None
    displacement_um[4000:] += 0.5 * np.random.default_rng(1).standard_normal(4000)
    cause, at = examined(SensorNoise(0.2), voltage_v, displacement_um, 40, 40)
    assert "the sensor's noise is 0." in cause
    assert 4000 < at <= 4800


def swings(growth, half_period_ticks, first_v=0.02, count=60):
    """Return the feedback that swings about zero, from tick to tick."""
    peaks_v = first_v * growth ** np.arange(count) * (-1.0) ** np.arange(count)
    return np.repeat(peaks_v, half_period_ticks)


def told_at(guard, feedback_v):
    """Return the first voltage that the guard refuses, and its largest one before that."""
    for at, voltage_v in enumerate(feedback_v):
        if guard.examine(voltage_v):
            return voltage_v, np.abs(feedback_v[:at]).max()
    return None


@settings(deadline=None)
@given(growth=st.floats(1.02, 30.0), half_period_ticks=st.integers(1, 8),
       noise_v=st.floats(0.0, 0.002), seed=st.integers(0, 1000))
def test_growing_oscillation_is_told_before_it_acts_with_more_than_the_limit(
        growth, half_period_ticks, noise_v, seed):
    until_1000_v = int(np.log(1000.0 / 0.02) / np.log(growth)) + 1
    feedback_v = swings(growth, half_period_ticks, count=min(until_1000_v, 300))
    feedback_v = feedback_v + noise_v * np.random.default_rng(seed).standard_normal(len(feedback_v))
    told = told_at(FeedbackOscillation(4.0), feedback_v)
    assert told is not None
    assert told[1] < 4.0


@settings(deadline=None)
@given(amplitude_v=st.floats(0.1, 50.0), frequency_hz=st.floats(0.5, 333.0),
       phase=st.floats(0.0, 1.5), seed=st.integers(0, 1000))
def test_steady_oscillation_is_let_pass_whatever_its_size(amplitude_v, frequency_hz, phase, seed):
    feedback_v = amplitude_v * np.sin(2e-3 * np.pi * frequency_hz * np.arange(2000) + phase)
    feedback_v += 0.001 * np.random.default_rng(seed).standard_normal(2000)
    assert told_at(FeedbackOscillation(4.0), feedback_v) is None


@pytest.mark.parametrize(("proportional", "integral"), [
    (0.0, 0.1), (0.2, 0.2), (0.5, 0.3), (0.6, 0.4), (0.3, 0.5)])
def test_feedback_that_follows_a_reference_alone_is_let_pass(proportional, integral):
    random = np.random.default_rng(0)
    time_s = np.arange(2000) * 1e-3
    references = [20.0 * np.sin(2 * np.pi * f * time_s) for f in (1, 10, 40, 60, 100, 150)]
    references += [
        sum(8.0 * np.sin(2 * np.pi * f * time_s + random.uniform(0, 6)) for f in tones)
        for tones in (random.choice([5, 10, 15, 20, 25, 30, 40], 4, replace=False)
                      for _ in range(12))]
    references += [np.where(time_s > 0.1, 20.0, 0.0)]
    for reference_um in references:
        guard, displacement_um, integral_v = FeedbackOscillation(4.0), 0.0, 0.0
        feedback_v = [0.0, 0.0]
        for wanted_um in reference_um:
            assert not guard.examine(feedback_v[-2])
            # A lag of a tick, and the declared delay.
            displacement_um += (1.0 - np.exp(-1.0)) * (feedback_v[-2] - displacement_um)
            error_um = wanted_um - displacement_um + 0.0015 * random.standard_normal()
            integral_v += integral * error_um
            feedback_v.append(proportional * error_um + integral_v)


def test_relay_that_swings_by_20_volts_is_let_pass():
    assert told_at(FeedbackOscillation(4.0), np.tile(np.repeat([10.0, -10.0], 4), 200)) is None


def test_slow_growth_such_as_that_of_a_reference_is_let_pass():
    feedback_v = swings(1.1, 20, first_v=0.1, count=50)
    assert told_at(FeedbackOscillation(4.0), feedback_v) is None


# Under the engine

class ProportionalStage:
    """Measures the voltage of the sample before; ``spoil`` changes what it measures."""

    sample_rate_hz = 40000.0

    def __init__(self, spoil=None):
        self.played_v = np.zeros(1)
        self.spoil = spoil

    def exchange(self, voltage_v):
        self.played_v = np.r_[self.played_v, voltage_v]
        displacement_um = self.played_v[-len(voltage_v) - 1:-1].copy()
        return self.spoil(displacement_um) if self.spoil else displacement_um


def guarded_engine(backend, **options):
    return StageEngine(backend, VoltageLimits(-20.0, 120.0, 2.0e6), sensor_guards=every_guard(),
                       feedback_guard=FeedbackOscillation(4.0), **options)


def test_lost_sensor_stops_the_stage_by_a_ramp_and_stays_stopped_for_the_next_engine():
    backend, latch = ProportionalStage(), StopLatch()
    engine = guarded_engine(backend, latch=latch)
    engine.commands.play(np.full(8000, 60.0), PERIOD_S)
    for _ in range(100):
        engine.advance()
    backend.spoil = lambda displacement_um: displacement_um * np.nan
    blocks = [engine.advance()]
    while not engine.idle:
        blocks.append(engine.advance())
    assert engine.stop_cause == "the sensor's reading is not a number"
    assert len(backend.played_v) == 1 + 101 * 40 + 1200
    assert np.abs(np.diff(backend.played_v)).max() <= 2000 * PERIOD_S + 1e-9
    assert backend.played_v[-1] == 0.0
    assert blocks[-1].flags & FLAG_STOPPED
    with pytest.raises(StageRefusal, match="the stage is stopped"):
        guarded_engine(backend, latch=latch).commands.play([1.0], PERIOD_S)


@pytest.mark.parametrize("gain", [-1.03, -1.3, -2.0, -4.0])
def test_loop_that_is_not_stable_is_stopped_before_5_um(gain):
    backend = ProportionalStage()
    engine = guarded_engine(backend)
    once_v = np.linspace(0.0, 50.0, 4000)
    engine.commands.load_feedforward(once_v, [50.0])
    engine.commands.start_tracking(feedback=True, ticks=4000)
    random = np.random.default_rng(1)
    integral_v = 0.0
    while not engine.idle:
        reference_v = np.interp(np.arange(40) + engine.next_sample, np.arange(4000), once_v)
        block = engine.advance()
        error_v = (block.displacement_um - reference_v).mean() + 0.002 * random.standard_normal()
        # Integral feedback of this delay is stable up to a gain of 1.
        integral_v += gain * error_v
        engine.answer(block.tick, integral_v)
    assert "the feedback oscillates with growing amplitude" in engine.stop_cause
    tracked_v = backend.played_v[1:]
    feedforward_v = np.interp(np.arange(len(tracked_v)), np.arange(4000), once_v)
    away = np.flatnonzero(np.abs(tracked_v - feedforward_v) > 5.0)[0]
    # What leads further away is the ramp to rest, which begins within the limit.
    assert np.all(np.diff(tracked_v[away:]) <= 1e-9)


@settings(deadline=None, max_examples=60)
@given(work=st.sampled_from(["play", "slow", "track"]), after=st.integers(0, 120),
       again_after=st.integers(0, 20))
def test_stop_at_any_moment_ramps_from_the_very_next_tick(work, after, again_after):
    backend = ProportionalStage()
    engine = guarded_engine(backend, longest_stretch_samples=TICK)
    if work == "track":
        engine.commands.load_feedforward(np.linspace(0.0, 80.0, 1600), [])
        engine.commands.start_tracking(feedback=False, ticks=90)
    else:
        engine.commands.play(np.full(40, 80.0), PERIOD_S * (1 if work == "play" else 40))
    for _ in range(after):
        engine.advance()
    at_v, begun = engine.voltage_v, len(backend.played_v)
    engine.stop("pressed")
    for _ in range(again_after):
        engine.advance()
    engine.stop("pressed again")
    while not engine.idle:
        engine.advance()
    ramp_v = np.r_[at_v, backend.played_v[begun:]]
    assert np.all(np.diff(ramp_v) <= 1e-9)
    assert np.abs(np.diff(ramp_v)).max(initial=0.0) <= 2000 * PERIOD_S + 1e-9
    assert engine.voltage_v == 0.0
    assert engine.stop_cause == "pressed"
    if at_v > 0.0:
        assert ramp_v[TICK] < at_v


def test_busy_stage_tells_for_whom_and_how_long_still():
    engine = guarded_engine(ProportionalStage())
    engine.commands.play(np.full(4000, 60.0), PERIOD_S, client="/left/identification")
    # Ramps of 60 V at 2 kV/s take 30 ms there and back, the waveform 100 ms.
    with pytest.raises(StageRefusal, match=r"busy \(approach for /left/identification, 0.16 s "):
        engine.commands.load_feedforward([0.0], [])
    engine = guarded_engine(ProportionalStage())
    engine.commands.load_feedforward([], [0.0])
    engine.commands.start_tracking(feedback=False)
    with pytest.raises(StageRefusal, match=r"busy \(track, until it is stopped\)"):
        engine.commands.load_feedforward([0.0], [])


def test_tracking_does_not_begin_with_a_jump_however_the_slew_limit_is():
    backend = ProportionalStage()
    engine = guarded_engine(backend)
    engine.commands.load_feedforward([2.1], [])
    with pytest.raises(ValueError, match=r"jumps by 2.1 V to sample 0, more than the 2 V"):
        engine.commands.start_tracking(feedback=False)
    assert engine.idle
    engine.commands.load_feedforward([1.9], [])
    engine.commands.start_tracking(feedback=False)


def test_answer_to_a_block_that_is_still_to_come_is_refused():
    engine = guarded_engine(ProportionalStage())
    engine.commands.load_feedforward([0.0], [])
    engine.commands.start_tracking(feedback=True)
    engine.advance()
    engine.answer(1, 0.0)
    with pytest.raises(ValueError, match="tick 2, which is still to come"):
        engine.answer(2, 0.0)
