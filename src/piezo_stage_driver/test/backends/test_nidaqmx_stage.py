# SPDX-License-Identifier: BSD-3-Clause
"""The backend for NI's cards against a stand-in; no device was there to try it on."""

import inspect
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from commands_by_name import command
from nidaqmx_stand_in import Card, DaqError, Reader, Task, Writer

from piezo_stage_driver.backends import nidaqmx_stage
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.calibration import TERMINALS, CalibrationError, load_calibration
from piezo_stage_driver.backends.nidaqmx_stage import NidaqmxStage, load_driver
from piezo_stage_driver.backends.registry import BackendSettings, create_backend
from piezo_stage_driver.engine.blocks import FLAG_TRACKING
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.engine.tick_times import TickTimes
from piezo_stage_driver.safety.limits import AxesLimits, VoltageLimits
from piezo_stage_driver.safety.supervisor import StageSupervisor
from piezo_stage_driver.safety.transitions import State

EXAMPLE = Path(__file__).parents[2] / "config" / "nidaqmx_calibration.yaml"
LEAD_TICKS = 20


def settings(**changes):
    return BackendSettings(**{
        "file": "", "sample_rate_hz": 40000.0, "samples_per_tick": 40, "minimum_voltage_v": -20.0,
        "maximum_voltage_v": 100.0, "rest_voltage_v": 0.0, "ramp_rate_v_per_s": 2000.0, **changes})


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(nidaqmx_stage.time, "sleep", lambda seconds: None)


@pytest.fixture
def card():
    return Card()


@pytest.fixture
def stage(card):
    stage = NidaqmxStage(load_calibration(EXAMPLE), settings(), card.driver())
    stage.open()
    return stage


def test_every_sample_is_played_once_in_order_and_scaled(card, stage):
    voltage_v = np.linspace(0.0, 90.0, 4000)
    for at in range(0, 4000, 40):
        stage.exchange(voltage_v[at:at + 40])
    for _ in range(LEAD_TICKS):
        stage.exchange(np.zeros(40))
    lead = LEAD_TICKS * 40
    assert np.array_equal(card.played_v[:lead], np.zeros(lead))
    assert np.allclose(card.played_v[lead:lead + 4000], voltage_v / 10.0, rtol=0, atol=1e-12)


def test_engine_publishes_what_the_card_applied_with_what_it_measured_at_that_instant(stage):
    engine = StageEngine(stage, VoltageLimits(-20.0, 100.0, 2.0e6))
    once_v = np.linspace(0.0, 60.0, 4000)
    engine.commands.load_feedforward(once_v, [])
    engine.commands.start_tracking(feedback=True, ticks=200)
    blocks = []
    while not engine.idle:
        blocks.append(engine.advance())
        if blocks[-1].flags & FLAG_TRACKING:
            engine.answer(blocks[-1].tick, 0.01)
    assert engine.missed_feedback == 0
    voltage_v = np.concatenate([block.voltage_v for block in blocks])
    displacement_um = np.concatenate([block.displacement_um for block in blocks])
    # The stand-in's stage has 1 um/V and shows each voltage one sample later.
    assert np.allclose(displacement_um[1:], voltage_v[:-1], rtol=0, atol=1e-9)
    tracked_v = np.concatenate([b.voltage_v for b in blocks if b.flags & FLAG_TRACKING])
    assert np.allclose(tracked_v[:800], once_v[:800])
    assert np.allclose(tracked_v[-40:], 60.01)


def test_computer_that_is_late_by_less_than_the_lead_disturbs_nothing(card, stage):
    voltage_v = np.linspace(0.0, 90.0, 4000)
    for at in range(0, 4000, 40):
        stage.exchange(voltage_v[at:at + 40])
        if at == 2000:
            card.be_late(LEAD_TICKS * 40 - 40)
    lead = LEAD_TICKS * 40
    played_v = np.array(card.played_v[lead:])
    assert np.allclose(played_v, voltage_v[:len(played_v)] / 10.0, rtol=0, atol=1e-12)


def axes_calibration(tmp_path, **changes):
    """Write the calibration of two axes, the second with an amplifier of half the gain."""
    one = yaml.safe_load(EXAMPLE.read_text())
    lead_ticks = one.pop("lead_ticks")
    x, y = one, one | {"output_channel": "Dev1/ao1", "input_channel": "Dev1/ai1",
                       "amplifier_gain": 5.0, "sensor_um_per_v": 20.0} | changes
    path = tmp_path / "axes.yaml"
    path.write_text(yaml.safe_dump({"axes": {"x": x, "y": y}, "lead_ticks": lead_ticks}))
    return path


def of_y(axis):
    return {"minimum_voltage_v": -10.0, "maximum_voltage_v": 50.0, "rest_voltage_v": 5.0,
            "ramp_rate_v_per_s": 500.0} if axis == "y" else {}


@pytest.fixture
def two_axes(tmp_path):
    card = Card(channels=2)
    stage = NidaqmxStage(
        load_calibration(axes_calibration(tmp_path)), settings(own=of_y), card.driver())
    stage.open()
    return card, stage


def test_axes_of_one_card_are_exchanged_together_and_scaled_each_by_its_own(two_axes):
    card, stage = two_axes
    assert stage.axes == ("x", "y")
    voltage_v = np.column_stack([np.linspace(0.0, 90.0, 4000), np.linspace(5.0, 45.0, 4000)])
    for at in range(0, 4000, 40):
        stage.exchange(voltage_v[at:at + 40])
    lead = LEAD_TICKS * 40
    assert np.allclose(card.played_v[:lead], [0.0, 1.0])  # at rest: 0 V, and 5 V by a gain of 5
    played_v = np.array(card.played_v[lead:])
    assert np.allclose(played_v, voltage_v[:len(played_v)] / [10.0, 5.0], rtol=0, atol=1e-12)
    # The stand-in shows the voltage of the card one sample later.
    measured_um = stage.exchange(voltage_v[-40:])
    assert measured_um.shape == (40, 2)
    assert np.allclose(measured_um, np.array(card.played_v[-41:-1]) * [10.0, 20.0])


def test_marks_are_put_out_with_the_samples_that_carry_them(tmp_path):
    path = axes_calibration(tmp_path)
    path.write_text(path.read_text() + "mark_lines: Dev1/port0/line0:3\n")
    card = Card(channels=2)
    stage = NidaqmxStage(load_calibration(path), settings(own=of_y), card.driver())
    stage.open()
    limits = AxesLimits({axis: VoltageLimits(-20.0, 50.0, 2.0e6) for axis in ("x", "y")})
    engine = StageEngine(stage, limits, np.array([0.0, 5.0]), np.full(2, 2000.0),
                         sensor_guards={"x": (), "y": ()})
    voltage_v = np.linspace([10.0, 20.0], [30.0, 0.0], 400)
    marks = np.arange(400) % 7 * (np.arange(400) % 5 == 0)
    engine.commands.play(voltage_v.ravel(), 1 / 40000.0, axes=("x", "y"), marks=marks)
    blocks = []
    while not engine.at_rest:
        blocks.append(engine.advance())
    played_v = np.array(card.played_v) * [10.0, 5.0]
    begin = int(np.flatnonzero(np.isclose(played_v, voltage_v[0]).all(axis=1))[-1])
    assert np.allclose(played_v[begin:begin + 400], voltage_v)
    put_out = np.array(card.put_out)
    assert np.array_equal(put_out[begin:begin + 400], marks)
    assert not put_out[:begin].any() and not put_out[begin + 400:].any()
    # Published beside the voltages that were applied at the same instant.
    published = np.concatenate([
        np.zeros(len(block.voltage_v)) if block.marks is None else block.marks
        for block in filter(None, blocks)])
    applied_v = np.concatenate([block.voltage_v for block in filter(None, blocks)])
    marked = np.flatnonzero(marks)
    assert np.array_equal(applied_v[published > 0], voltage_v[marked])
    assert np.array_equal(published[published > 0], marks[marked])


def test_card_that_runs_out_ramps_all_axes_to_their_rest_each_at_its_rate(two_axes):
    card, stage = two_axes
    for _ in range(2 * LEAD_TICKS):
        stage.exchange(np.tile([50.0, 30.0], (40, 1)))
    card.be_late(LEAD_TICKS * 40 + 1)
    with pytest.raises(BackendFault, match="the output ran out of samples"):
        stage.exchange(np.tile([50.0, 30.0], (40, 1)))
    ramp_v = np.array(card.single_v) * [10.0, 5.0]
    assert np.allclose(ramp_v[[0, -1]], [[50.0, 30.0], [0.0, 5.0]])
    steps_v = np.abs(np.diff(ramp_v, axis=0)).max(axis=0)
    assert np.all(steps_v <= np.array([2.0, 0.5]) + 1e-9) and card.open_tasks == 0


def test_voltages_of_one_axis_beyond_the_card_are_refused_with_its_name(tmp_path):
    with pytest.raises(ValueError, match="y: the card reaches -10 to 50 V at the stage"):
        NidaqmxStage(load_calibration(axes_calibration(tmp_path)), settings(), Card(
            channels=2).driver())


@pytest.mark.parametrize(("changes", "sentence"), [
    ({"input_channel": "Dev2/ai1", "output_channel": "Dev2/ao1"},
     r"axes\.y\.input_channel is on Dev2, another axis on Dev1; use channels of one card"),
    ({"output_channel": "Dev1/ao0"}, "axes name one output_channel twice; give each its own"),
    ({"amplifier_gain": 0.0}, r"axes\.y\.amplifier_gain is 0; measure it"),
])
def test_impossible_calibration_of_axes_is_refused_in_one_sentence(tmp_path, changes, sentence):
    with pytest.raises(CalibrationError, match=sentence):
        load_calibration(axes_calibration(tmp_path, **changes))


@pytest.mark.parametrize(("late_samples", "sentence"), [
    (LEAD_TICKS * 40 + 1, r"the output ran out of samples: .* \(NI-DAQmx -200290\)"),
    (40_001, r"the output ran out of samples"),
])
def test_computer_that_is_later_ends_at_rest_by_a_ramp(card, stage, late_samples, sentence):
    for _ in range(2 * LEAD_TICKS):
        stage.exchange(np.full(40, 50.0))
    card.be_late(late_samples)
    with pytest.raises(BackendFault, match=sentence):
        stage.exchange(np.full(40, 50.0))
    assert card.single_v[0] == pytest.approx(5.0)
    assert card.single_v[-1] == card.held_v == 0.0
    assert np.abs(np.diff(card.single_v)).max() <= 0.2 + 1e-9  # 2000 V/s in steps of 1 ms
    assert card.open_tasks == 0


def test_lost_input_ends_at_rest_from_the_voltage_that_was_playing(card, stage):
    for level_v in np.linspace(0.0, 80.0, 81):
        stage.exchange(np.full(40, level_v))
    card.fault = DaqError("overwritten", -200279)
    with pytest.raises(BackendFault, match="were overwritten before they were read"):
        stage.exchange(np.full(40, 80.0))
    assert 10.0 * card.single_v[0] == pytest.approx(80.0 - LEAD_TICKS + 1, abs=1.0)
    assert card.held_v == 0.0


def test_card_that_is_gone_ends_without_a_traceback(card, stage, monkeypatch):
    def gone(*_, **__):
        raise DaqError("Device is not connected.", -200324)
    monkeypatch.setattr(Reader, "read_many_sample", gone)
    monkeypatch.setattr(Task, "write", gone)
    with pytest.raises(BackendFault, match=r"the card failed: Device is not connected\. \(NI-D"
                       ) as fault:
        stage.exchange(np.zeros(40))
    assert not fault.value.at_rest
    stage.close()


def late(card, monkeypatch):
    card.be_late(LEAD_TICKS * 40 + 1)


def lost(card, monkeypatch):
    card.fault = DaqError("overwritten", -200279)


def gone(card, monkeypatch):
    def fail(*_, **__):
        raise DaqError("Device is not connected.", -200324)
    monkeypatch.setattr(Reader, "read_many_sample", fail)
    monkeypatch.setattr(Task, "write", fail)


@pytest.mark.parametrize("work", ["play", "track"])
@pytest.mark.parametrize("bad_luck", [late, lost, gone])
def test_after_a_fault_the_card_ramps_to_rest_and_nothing_follows(
        card, monkeypatch, bad_luck, work):
    supervisor = StageSupervisor(
        NidaqmxStage(load_calibration(EXAMPLE), settings(), card.driver()),
        lambda backend, latch: StageEngine(
            backend, VoltageLimits(-20.0, 100.0, 2.0e6), latch=latch,
            longest_stretch_samples=40))
    told, ends = [], []
    goal = SimpleNamespace(cancelled=False, attend=lambda engine: None,
                           end=lambda *end: ends.append(end))
    supervisor.activate()

    def ask(name, *arguments, goal=None):
        supervisor.submit(command(
            name, *arguments, on_done=lambda *answer: told.append(answer), goal=goal))

    if work == "play":
        ask("play", np.full(400_000, 50.0), 25e-6, goal=goal)
    else:
        ask("load_feedforward", np.linspace(0.0, 50.0, 1000), [])
        ask("start_tracking", False)
    for _ in range(4 * LEAD_TICKS):
        supervisor.tick()
    assert all(error is None for _, error in told)
    assert card.held_v == 5.0
    bad_luck(card, monkeypatch)
    played = len(card.played_v)
    ask("load_feedforward", [0.0], [])
    for _ in range(100):
        supervisor.tick()
    assert supervisor.state is State.FAULTED
    assert supervisor.at_rest is (bad_luck is not gone)
    assert card.open_tasks == 0
    assert len(card.played_v) <= played + 40  # of the exchange that failed
    if bad_luck is not gone:
        assert np.all(np.diff(card.single_v) <= 1e-12)
        assert card.single_v[-1] == card.held_v == 0.0
    assert [cause.startswith("the card failed") for cause, _ in ends] == [True] * (work == "play")
    supervisor.leave("deactivated")
    assert supervisor.state is State.INACTIVE
    assert card.open_tasks == 0


def test_clock_that_the_card_rounds_is_refused():
    card = Card(clock_hz=40040.04)
    stage = NidaqmxStage(load_calibration(EXAMPLE), settings(), card.driver())
    with pytest.raises(ValueError, match="goes at 40040 Hz, not at 40000 Hz: set sample_rate_hz"):
        stage.open()
    assert card.open_tasks == 0


def test_voltages_beyond_the_card_are_refused(card):
    with pytest.raises(ValueError, match="the card reaches -20 to 100 V at the stage"):
        NidaqmxStage(load_calibration(EXAMPLE), settings(maximum_voltage_v=120.0), card.driver())


def test_stage_can_be_opened_again(card, stage):
    stage.exchange(np.zeros(40))
    stage.close()
    assert card.open_tasks == 0
    stage.open()
    stage.exchange(np.zeros(40))


def test_missing_driver_gets_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(ValueError) as failure:
        create_backend("nidaqmx", settings(file=str(EXAMPLE)))
    assert str(failure.value).startswith("the backend nidaqmx needs the Python package nidaqmx")
    assert "\n" not in str(failure.value)


def test_stand_in_has_the_signatures_of_the_package():
    pytest.importorskip("nidaqmx", reason="the optional package is not installed")
    driver = load_driver()
    for ours, theirs in ((Reader.read_many_sample, driver.Reader.read_many_sample),
                         (Writer.write_many_sample, driver.Writer.write_many_sample),
                         (Reader.read_many_sample, driver.AxesReader.read_many_sample),
                         (Writer.write_many_sample, driver.AxesWriter.write_many_sample),
                         (Task.write, driver.Task.write)):
        assert inspect.signature(ours).parameters.keys() <= (
            inspect.signature(theirs).parameters.keys())
    assert driver.DaqError("text", -200290).error_code == -200290
    assert driver.constants.RegenerationMode.DONT_ALLOW_REGENERATION
    assert set(TERMINALS) == {terminal.name for terminal in driver.constants.TerminalConfiguration}


# Calibration

def test_calibration_scales_both_ways():
    calibration = load_calibration(EXAMPLE)
    assert calibration.voltage_range_v == (-20.0, 100.0)
    assert calibration.voltage_v(calibration.card_v(37.0)) == pytest.approx(37.0)
    assert calibration.displacement_um(2.5) == pytest.approx(25.0)


@pytest.mark.parametrize(("change", "sentence"), [
    ({"lead_ticks": 0}, "lead_ticks is out of range .found 0.; give a number from 1"),
    ({"lead_ticks": 1.5}, "lead_ticks is not a whole number .found 1.5.; give a whole number"),
    ({"amplifier_gain": 0.0}, "amplifier_gain is 0"),
    ({"amplifier_gain": "ten"},
     'amplifier_gain is not a finite number .found "ten".; give a finite number'),
    ({"amplifier_gain": float("nan")}, "give a finite number"),
    ({"amplifier_gain": True}, "give a finite number"),
    ({"input_channel": "Dev2/ai0"}, "is not on the device of input_channel"),
    ({"input_minimum_v": 10.0}, "input_minimum_v is not below"),
    ({"terminal_configuration": "SINGLE"}, "terminal_configuration is none of DEFAULT, DIFF"),
    ({"gain": 1.0}, "gain is unknown"),
    ({"sensor_um_per_v": None}, "sensor_um_per_v is not a finite number .found null"),
])
def test_impossible_calibration_is_refused_in_one_sentence(tmp_path, change, sentence):
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(EXAMPLE.read_text()), **change}))
    with pytest.raises(CalibrationError, match=sentence) as failure:
        load_calibration(path)
    assert str(failure.value).startswith(str(path))


@pytest.mark.parametrize("text", ["", "[1, 2]", "a: [", "output_channel: Dev1/ao0"])
def test_file_that_is_no_calibration_is_refused(tmp_path, text):
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError):
        load_calibration(path)
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_calibration(tmp_path / "none.yaml")


@pytest.mark.parametrize(("late_ticks", "missed"), [(LEAD_TICKS - 2, 0), (LEAD_TICKS + 2, 1)])
def test_loop_counts_a_tick_as_missed_where_the_card_runs_out(card, stage, late_ticks, missed):
    # The card's clock is the only one there is.
    passed = [0]
    pass_samples = card.be_late

    def be_late(samples):
        passed[0] += samples
        pass_samples(samples)

    card.be_late = be_late
    times = TickTimes(stage, lambda: passed[0] / card.clock_hz)
    for _ in range(5):
        times.exchange(np.zeros(40))
    card.be_late(40 * late_ticks)
    if missed:
        with pytest.raises(BackendFault, match="ran out of samples"):
            times.exchange(np.zeros(40))
    else:
        times.exchange(np.zeros(40))
    assert times.missed == missed
