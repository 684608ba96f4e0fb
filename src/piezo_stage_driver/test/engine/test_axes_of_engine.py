# SPDX-License-Identifier: BSD-3-Clause
"""A stage of two axes: each within its own limits and guards, and what stops one stops both."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from linear_stage_loop import finish

from piezo_stage_driver.engine.blocks import FLAG_PLAYING, FLAG_STOPPED
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import SensorNoise, SensorRange, SensorResponse
from piezo_stage_driver.safety.limits import (
    FLAG_RANGE_LIMITED,
    FLAG_SLEW_LIMITED,
    AxesLimits,
    LimitError,
    VoltageLimits,
)

PERIOD_S, TICK = 1 / 40_000.0, 40
X_LIMITS, Y_LIMITS = VoltageLimits(-20.0, 120.0, 2.0e6), VoltageLimits(0.0, 60.0, 4.0e5)
LIMITS = AxesLimits({"x": X_LIMITS, "y": Y_LIMITS})
AXES = ("x", "y")


class Backend:
    """Measures half the voltage of each axis, or what is put in its place."""

    sample_rate_hz = 40_000.0
    axes = AXES

    def __init__(self):
        self.played_v = []
        self.spoil = lambda displacement_um: None

    def exchange(self, voltage_v):
        self.played_v.append(voltage_v)
        displacement_um = 0.5 * voltage_v
        self.spoil(displacement_um)
        return displacement_um

    @property
    def voltage_v(self):
        return np.concatenate(self.played_v)


class OneAxis(Backend):
    axes = ()


def guards():
    return (SensorRange(-15.0, 65.0), SensorResponse(20.0, 0.4), SensorNoise(0.2))


def make_engine(backend_class=Backend, **options):
    backend = backend_class()
    return StageEngine(
        backend, LIMITS, np.array([0.0, 10.0]), np.array([2000.0, 1000.0]),
        sensor_guards={"x": guards(), "y": guards()}, **options), backend


def circle(samples=400):
    phase = 2.0 * np.pi * np.arange(samples) / samples
    return np.column_stack([40.0 + 30.0 * np.cos(phase), 30.0 + 20.0 * np.sin(phase)])


def play(engine, voltage_v, period_s=PERIOD_S, **options):
    return engine.commands.play(np.ravel(voltage_v), period_s, axes=AXES, **options)


def test_waveform_is_played_sample_by_sample_between_ramps_of_both_axes():
    engine, backend = make_engine()
    first, count = play(engine, circle(), repeats=2)
    blocks = finish(engine)
    assert count == 800
    assert np.array_equal(backend.voltage_v[first:first + 800], np.tile(circle(), (2, 1)))
    assert np.array_equal(backend.voltage_v[-1], [0.0, 10.0])
    assert np.array_equal(np.concatenate([block.voltage_v for block in blocks]),
                          backend.voltage_v)
    # The axis that takes longer decides: 70 V at 2000 V/s against 20 V at 1000 V/s.
    assert first == 1400
    steps_v = np.abs(np.diff(backend.voltage_v[:first], axis=0))
    assert np.allclose(steps_v, [70.0 / 1400, 20.0 / 1400])


def test_slow_waveform_is_published_as_means_of_each_axis():
    engine, _ = make_engine()
    play(engine, circle(20), 0.001)
    playing = [block for block in finish(engine) if block.flags & FLAG_PLAYING]
    assert np.allclose(np.concatenate([block.voltage_v for block in playing])[:20], circle(20))
    assert all(block.voltage_v.shape == block.displacement_um.shape for block in playing)


class Detecting(Backend):
    """A detector of twice the voltage of x, and digital lines."""

    signals = ("camera",)

    def __init__(self):
        super().__init__()
        self.put_out = {}

    def put_out_marks(self, marks):
        self.put_out[len(self.played_v)] = marks

    def read_signals(self):
        return 2.0 * self.played_v[-1][:, :1]


def test_marks_of_a_waveform_are_put_out_and_published_with_its_samples_in_every_repeat():
    engine, backend = make_engine(Detecting)
    marks = np.zeros(400, np.uint8)
    marks[[0, 100, 399]] = 7, 1, 2
    first, _ = play(engine, circle(), repeats=2, marks=marks)
    blocks = finish(engine)
    wanted = np.zeros(len(backend.voltage_v), np.uint8)
    wanted[first:first + 800] = np.tile(marks, 2)
    put_out = [backend.put_out.get(number, np.zeros(len(each), np.uint8))
               for number, each in enumerate(backend.played_v)]
    assert np.array_equal(np.concatenate(put_out), wanted)
    published = {block.first_sample + at: block.marks[at] for block in blocks
                 if block.marks is not None for at in np.flatnonzero(block.marks)}
    assert published == {at: wanted[at] for at in np.flatnonzero(wanted)}


def test_marks_and_signals_of_a_slow_waveform_are_those_of_its_values():
    engine, _ = make_engine(Detecting)
    marks = np.arange(20) % 4
    play(engine, circle(20), 0.001, marks=marks)
    playing = [block for block in finish(engine) if block.flags & FLAG_PLAYING]
    assert np.array_equal(np.concatenate([block.marks for block in playing])[:20], marks)
    assert np.allclose(np.concatenate([block.signal for block in playing])[:20, 0],
                       2.0 * circle(20)[:, 0])


def test_marks_of_a_feedforward_are_put_out_once_and_in_every_period():
    engine, backend = make_engine(Detecting)
    once, period = np.zeros(200, np.uint8), np.zeros(400, np.uint8)
    once[150], period[[0, 399]] = 4, (3, 1)
    once_v = np.linspace([0.0, 10.0], circle()[0], 200)
    for marks, wanted in (
            ((once, period), np.concatenate([once, period, period])),
            (((), period), np.concatenate([0 * once, period, period])),
            ((once, ()), np.concatenate([once, 0 * period, 0 * period]))):
        engine.commands.load_feedforward(once_v.ravel(), circle().ravel(), False, 0, AXES, *marks)
        backend.put_out.clear()
        first = engine.next_sample
        engine.commands.start_tracking(False, 25)
        finish(engine)
        put_out = np.concatenate([backend.put_out.get(number, np.zeros(len(each), np.uint8))
                                  for number, each in enumerate(backend.played_v)])
        assert np.array_equal(put_out[first:first + 1000], wanted)
    with pytest.raises(StageRefusal, match="400 samples and 3 marks: give a mark for each"):
        engine.commands.load_feedforward(once_v.ravel(), circle().ravel(), False, 0, AXES, (),
                                         (1, 2, 3))
    engine.commands.load_feedforward(once_v.ravel(), (), axes=AXES)
    with pytest.raises(StageRefusal, match="a stream carries no marks"):
        engine.commands.load_feedforward(once_v[::-1].ravel(), (), True, 0, AXES, once)


def test_stop_ends_the_marks():
    engine, backend = make_engine(Detecting)
    play(engine, circle(4000), marks=np.ones(4000, np.uint8))
    while engine.phase_name != "play":
        engine.advance()
    engine.stop("of the test")
    put_out = len(backend.put_out)
    assert all(block.marks is None for block in finish(engine))
    assert len(backend.put_out) == put_out


def test_marks_that_do_not_fit_the_samples_are_refused():
    engine, _ = make_engine()
    with pytest.raises(StageRefusal, match="400 samples and 399 marks: give a mark for each"):
        play(engine, circle(), marks=np.ones(399))


def test_waveform_that_holds_at_its_end_leaves_both_axes_there():
    engine, _ = make_engine()
    play(engine, [[30.0, 20.0]], hold_at_end=True)
    finish(engine)
    assert np.array_equal(engine.voltage_v, [30.0, 20.0]) and not engine.at_rest


def test_axis_that_rests_leaves_the_other_as_if_it_were_alone():
    engine, backend = make_engine()
    voltage_v = circle()
    voltage_v[:, 1] = 10.0
    play(engine, voltage_v)
    blocks = finish(engine)
    alone_backend = OneAxis()
    alone = StageEngine(alone_backend, X_LIMITS)
    alone.commands.play(voltage_v[:, 0], PERIOD_S)
    alone_blocks = finish(alone)
    assert np.array_equal(backend.voltage_v[:, 0], alone_backend.voltage_v)
    assert [(block.first_sample, block.flags) for block in blocks] == [
        (block.first_sample, block.flags) for block in alone_blocks]


@pytest.mark.parametrize(("voltage_v", "sentence"), [
    ([[30.0, 20.0], [30.0, 61.0]], r"y: voltage sample 1 is 61 V, outside \[0, 60\] V"),
    ([[-21.0, 20.0]], r"x: voltage sample 0 is -21 V, outside \[-20, 120\] V"),
    ([[30.0, 20.0], [45.0, 32.0]], "y: the voltage jumps by 12 V to sample 1, more than the 10 V"),
    ([[30.0, np.nan]], "y: voltage sample 0 is not a finite number"),
    (np.empty((0, 2)), "x: the voltage sequence is empty"),
])
def test_voltage_that_one_axis_must_not_play_is_refused_with_its_name(voltage_v, sentence):
    engine, backend = make_engine()
    with pytest.raises(LimitError, match=sentence):
        play(engine, voltage_v)
    assert not backend.played_v and engine.idle


def test_way_back_to_the_first_sample_of_a_repeated_waveform_counts_on_each_axis():
    engine, _ = make_engine()
    with pytest.raises(LimitError, match="y: the voltage jumps by 12 V to sample 0"):
        play(engine, [[30.0, 20.0], [30.0, 26.0], [30.0, 32.0]], repeats=2)


@pytest.mark.parametrize("axes", [(), ("x",), ("y", "x"), ("x", "y", "z")])
def test_waveform_of_other_axes_is_refused_by_their_names(axes):
    engine, _ = make_engine()
    with pytest.raises(StageRefusal, match="the stage has the axes x, y: give a voltage of each"):
        engine.commands.play(np.zeros(12), PERIOD_S, axes=axes)


def test_stage_of_one_axis_refuses_a_waveform_of_two():
    with pytest.raises(StageRefusal, match="of the axes x, y, the stage has one axis without a"):
        StageEngine(OneAxis(), X_LIMITS).commands.play(np.zeros(12), PERIOD_S, axes=AXES)


def test_waveform_that_lacks_a_voltage_of_one_axis_is_refused():
    engine, _ = make_engine()
    with pytest.raises(StageRefusal, match="3 voltages for 2 axes: give as many of each"):
        play(engine, np.zeros(3))


def test_replacement_within_a_run_takes_one_axis():
    engine, _ = make_engine()
    with pytest.raises(StageRefusal, match="the axes x, y: load feedforward and law between"):
        engine.commands.replacement(np.zeros(40), (), None)


def rest_after(engine, blocks=400):
    return [block for _ in range(blocks) if (block := engine.advance()) is not None]


@pytest.mark.parametrize(("column", "axis"), [(0, "x"), (1, "y")])
@pytest.mark.parametrize(("spoil", "what"), [
    (lambda readings: readings.fill(np.nan), "the sensor's reading is not a number"),
    (lambda readings: readings.fill(70.0), r"the sensor reads 70 um, outside \[-15, 65\] um"),
    (lambda readings: readings.fill(3.0), "the sensor is stuck"),
    (lambda readings: readings.__iadd__(np.resize([1.0, -1.0], len(readings))),
     "the sensor's noise is"),
])
def test_fault_of_one_axis_stops_both_with_its_name(column, axis, spoil, what):
    engine, backend = make_engine()
    backend.spoil = lambda displacement_um: spoil(displacement_um[:, column])
    play(engine, circle(4000))
    rest_after(engine)
    assert re.match(f"{axis}: {what}", engine.stop_cause)
    assert engine.at_rest and np.array_equal(backend.voltage_v[-1], [0.0, 10.0])
    with pytest.raises(StageRefusal, match="the stage is stopped"):
        play(engine, circle())


def test_stop_ramps_both_axes_to_their_rest_at_their_own_rate():
    engine, backend = make_engine()
    play(engine, circle(40_000))
    for _ in range(20):
        engine.advance()
    before = len(backend.voltage_v)
    engine.stop("emergency stop")
    blocks = rest_after(engine)
    steps_v = np.abs(np.diff(backend.voltage_v[before - 1:], axis=0)).max(axis=0)
    assert np.all(steps_v <= np.array([2000.0, 1000.0]) * PERIOD_S * (1.0 + 1e-9))
    assert engine.at_rest and all(block.flags & FLAG_STOPPED for block in blocks)


def test_axis_that_rests_is_not_taken_for_stuck_while_the_other_moves():
    engine, _ = make_engine()
    voltage_v = circle(8000)
    voltage_v[:, 1] = 10.0
    play(engine, voltage_v)
    finish(engine)
    assert not engine.stop_cause


voltages = st.floats(-200.0, 200.0) | st.sampled_from([np.nan, np.inf, -np.inf])


@given(st.lists(st.tuples(voltages, voltages), min_size=1, max_size=50))
@settings(max_examples=50, deadline=None)
def test_whatever_is_wanted_each_axis_stays_within_its_own_limits(wanted):
    wanted_v, previous_v = np.array(wanted), np.array([0.0, 10.0])
    limited_v, flags = LIMITS.apply(wanted_v, previous_v, PERIOD_S)
    assert np.all(limited_v >= [-20.0, 0.0]) and np.all(limited_v <= [120.0, 60.0])
    steps_v = np.abs(np.diff(limited_v, axis=0, prepend=previous_v[None]))
    assert np.all(steps_v <= np.array([50.0, 10.0]) * (1.0 + 1e-8))
    if np.all(np.isfinite(wanted_v)) and not flags:
        assert np.array_equal(limited_v, wanted_v)
    if np.any(np.isfinite(wanted_v) & ((wanted_v < [-20.0, 0.0]) | (wanted_v > [120.0, 60.0]))):
        assert flags & FLAG_RANGE_LIMITED


def test_slew_of_one_axis_is_flagged_and_leaves_the_other():
    limited_v, flags = LIMITS.apply(
        np.array([[40.0, 40.0]] * 3), np.array([0.0, 10.0]), PERIOD_S)
    assert flags == FLAG_SLEW_LIMITED
    assert np.allclose(limited_v, [[40.0, 20.0], [40.0, 30.0], [40.0, 40.0]])


def test_rest_voltage_outside_the_range_of_one_axis_is_refused_with_its_name():
    with pytest.raises(LimitError, match=r"y: the rest voltage is -5 V, outside \[0, 60\] V"):
        StageEngine(Backend(), LIMITS, np.array([0.0, -5.0]))
