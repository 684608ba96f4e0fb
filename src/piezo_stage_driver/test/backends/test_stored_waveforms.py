# SPDX-License-Identifier: BSD-3-Clause
"""The backends for controllers with a waveform memory, against stand-ins; none was there to try."""

import sys
from dataclasses import dataclass
from typing import Any

import gcs_stand_in
import numpy as np
import nv200_stand_in
import pytest
import yaml
from stored_waveform_runs import (
    CONFIG,
    LONGEST,
    RATE_HZ,
    WAVE_V,
    assert_refused,
    engine_of,
    played,
    settings,
    supervised,
)

from piezo_common.schema import load_document
from piezo_stage_driver.backends import nv200_stage, pi_gcs_stage, stored_waveforms
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.nv200_stage import Nv200, Nv200Settings
from piezo_stage_driver.backends.pi_gcs_stage import PiController, PiSettings
from piezo_stage_driver.backends.stored_waveforms import StoredWaveformStage
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.safety.transitions import State


@dataclass
class Kind:
    """One backend with its stand-in."""

    name: str
    device: Any
    instrument: Any
    module: Any
    document: Any

    @property
    def held_v(self):
        return np.max(self.device.held_v if self.name == "nv200" else self.device.held)


def make_pi(**device):
    controller = gcs_stand_in.Controller(**device)
    told = load_document(PiSettings, CONFIG / "pi_gcs_settings.yaml")
    return Kind("pi_gcs", controller, PiController(told, gcs_stand_in.library(controller)),
                pi_gcs_stage, PiSettings)


def make_nv200(**device):
    box = nv200_stand_in.Box(**device)
    told = load_document(Nv200Settings, CONFIG / "nv200_settings.yaml")
    return Kind("nv200", box, Nv200(told, nv200_stand_in.library(box)), nv200_stage, Nv200Settings)


MAKERS = {"pi_gcs": make_pi, "nv200": make_nv200}


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(stored_waveforms.time, "sleep", lambda seconds: None)


@pytest.fixture(params=sorted(MAKERS))
def make(request):
    return MAKERS[request.param]


@pytest.fixture
def kind(make):
    made = make()
    yield made
    made.device.gone = False
    made.instrument.close()


def stage_of(kind, **changes):
    return StoredWaveformStage(kind.instrument, settings(**changes), LONGEST, 10.0)


def test_waveform_comes_back_with_what_was_measured_at_each_sample(kind):
    stage = stage_of(kind)
    stage.open()
    engine = engine_of(stage)
    voltage_v, displacement_um = played(engine, WAVE_V)
    assert np.allclose(voltage_v, WAVE_V)
    # The stand-in's stage has 1 um/V and shows each voltage one sample later.
    assert np.allclose(displacement_um[1:], WAVE_V[:-1], atol=1e-4)
    assert kind.held_v == 0.0
    again_v, again_um = played(engine, WAVE_V[::-1])
    assert np.allclose(again_um[1:], again_v[:-1], atol=1e-4)
    stage.close()
    assert not kind.device.connected


def test_instrument_is_open_loop_and_at_rest_before_anything_is_played(kind):
    if kind.name == "pi_gcs":
        kind.device.held[0] = 50.0
    else:
        kind.device.held_v = 50.0
    stage = stage_of(kind)
    stage.open()
    # A ramp of 2000 V/s in steps of 10 ms.
    assert np.allclose(kind.device.sent_v, [50 - 50 / 3, 50 / 3, 0.0, 0.0], atol=1e-3)


def test_servo_that_stays_on_is_refused(make):
    kind = make(deaf_servo=True)
    stage = stage_of(kind)
    with pytest.raises(ValueError, match="servo of axis 1 stays on|stays in closed loop"):
        stage.open()
    assert not kind.device.connected


def test_rate_that_the_clock_does_not_divide_to_is_refused_with_those_it_does(kind):
    stage = stage_of(kind, sample_rate_hz=40000.0)
    with pytest.raises(ValueError, match="plays 20000 samples a second divided by a whole number, "
                                         "not 40000: set sample_rate_hz to 20000"):
        stage.open()
    stage = stage_of(kind, sample_rate_hz=3000.0)
    with pytest.raises(ValueError, match="set sample_rate_hz to 3333.333333 or 2857.142857"):
        stage.open()


def test_waveform_beyond_the_memory_is_refused_with_what_fits(kind):
    engine = engine_of(stage_of(kind))
    with pytest.raises(StageRefusal, match=r"the waveform takes \d+ samples with its ramps, 1000 "
                                           "are what the backend plays at once"):
        engine.commands.play(np.full(980, 50.0), 1.0 / RATE_HZ)
    engine.commands.play(np.full(800, 50.0), 1.0 / RATE_HZ)


def test_what_needs_samples_while_they_play_is_refused(kind):
    engine = engine_of(stage_of(kind))
    with pytest.raises(StageRefusal, match="stored waveforms only, and cannot be led sample by"):
        engine.commands.load_feedforward(np.zeros(100), [])
    with pytest.raises(StageRefusal, match="end at rest: set hold_at_end to false"):
        engine.commands.play(WAVE_V, 1.0 / RATE_HZ, hold_at_end=True)


def test_longest_waveform_is_within_what_the_node_waits(kind):
    with pytest.raises(ValueError, match="the node waits 2 s: set exchange_timeout_s higher"):
        stage_of(kind, exchange_timeout_s=2.0)


def test_goal_ends_once_the_instrument_has_played_it(kind):
    supervisor, ends = supervised(stage_of(kind), engine_of, WAVE_V)
    while not ends:
        assert supervisor.active
        supervisor.tick()
    assert ends[0][0] == ""
    assert supervisor.engine.at_rest


def test_stop_before_the_waveform_began_plays_nothing(kind):
    supervisor, _ = supervised(stage_of(kind), engine_of, WAVE_V)
    for _ in range(20):
        supervisor.tick()
    before = list(kind.device.sent_v)
    supervisor.stop("somebody pressed the button")
    while supervisor.active and supervisor.state is not State.LATCHED:
        supervisor.tick()
    for _ in range(2 * LONGEST // 10):
        supervisor.tick()
    assert kind.held_v == 0.0
    assert kind.device.sent_v == before
    assert not kind.device.running
    assert supervisor.at_rest


def test_stop_while_it_plays_ends_at_rest_by_a_ramp(kind, monkeypatch):
    monkeypatch.setattr(gcs_stand_in, "CYCLES_PER_QUESTION", 1000)
    monkeypatch.setattr(nv200_stand_in, "STEPS_PER_QUESTION", 1000)
    supervisor, ends = supervised(stage_of(kind), engine_of, WAVE_V)

    def press(seconds):
        if kind.device.running and kind.device.played > 200:
            supervisor.stop("somebody pressed the button")
    monkeypatch.setattr(stored_waveforms.time, "sleep", press)
    while supervisor.active:
        supervisor.tick()
    assert 200 < kind.device.played < 500
    assert kind.held_v == 0.0
    assert np.abs(np.diff(kind.device.sent_v[1:])).max(initial=0.0) <= 20.0 + 1e-6
    assert supervisor.state is State.FAULTED and supervisor.at_rest
    assert ends[0][0].startswith("somebody pressed")


def test_device_that_is_gone_ends_without_a_traceback(kind):
    stage = stage_of(kind)
    stage.open()
    engine = engine_of(stage)
    kind.device.gone = True
    with pytest.raises(BackendFault, match=f"{kind.name} failed: ") as fault:
        played(engine, WAVE_V)
    assert not fault.value.at_rest
    stage.close()
    with pytest.raises(ValueError, match=f"{kind.name} cannot be opened: "):
        stage.open()


def test_voltage_other_than_the_one_given_is_a_fault(make):
    kind = make(played_scale=0.7)
    stage = stage_of(kind)
    stage.open()
    with pytest.raises(BackendFault, match="its own record of the voltage is .* off what it was"):
        played(engine_of(stage), WAVE_V)
    assert kind.held_v == 0.0
    stage.close()


def test_idle_stage_is_read_now_and_then(kind):
    stage = stage_of(kind)
    stage.open()
    assert np.array_equal(stage.exchange(np.zeros(10)), np.zeros(10))
    stage.close()


@pytest.mark.parametrize("name", sorted(MAKERS))
def test_missing_library_and_missing_file_get_one_line(name, monkeypatch, make):
    module = MAKERS[name]().module
    with pytest.raises(ValueError, match=f"the backend {name} needs its settings"):
        module.create(settings())
    monkeypatch.setitem(sys.modules, {"pi_gcs": "pipython", "nv200": "nv200"}[name], None)
    with pytest.raises(ValueError) as failure:
        module.create(settings(file=str(CONFIG / f"{name}_settings.yaml")))
    assert str(failure.value).startswith(f"the backend {name} needs the Python package")
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize(("name", "change", "sentence"), [
    ("pi_gcs", {"interface": "gpib"}, "interface is not 'tcpip' or 'usb'"),
    ("pi_gcs", {"control_per_v": 0.0}, "control_per_v is 0"),
    ("pi_gcs", {"transfer_s": 0.0}, "transfer_s is out of range"),
    ("pi_gcs", {"axis": None}, "axis"),
    ("nv200", {"interface": "tcp"}, "interface is not 'serial' or 'telnet'"),
    ("nv200", {"longest_program_samples": 2000}, "longest_program_samples is out of range"),
    ("nv200", {"rate": 1}, "rate is unknown"),
    ("nv200", {"axes": {"x": {}, "y": {}}},
     "axes is not possible: an NV200 drives one axis, and shares its clock with no other; use a"),
])
def test_impossible_settings_are_refused_in_one_sentence(tmp_path, name, change, sentence):
    document = yaml.safe_load((CONFIG / f"{name}_settings.yaml").read_text())
    assert_refused(MAKERS[name]().module, {**document, **change}, tmp_path / "settings.yaml",
                   sentence)


def test_record_that_the_controller_cannot_hold_is_refused():
    kind = make_pi(tables=500)
    stage = stage_of(kind)
    with pytest.raises(ValueError, match="E-727 records 524 samples at a time"):
        stage.open()
