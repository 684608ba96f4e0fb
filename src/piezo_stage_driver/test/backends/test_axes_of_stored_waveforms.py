# SPDX-License-Identifier: BSD-3-Clause
"""Two axes of one controller with a waveform memory, which is a stand-in."""

import gcs_stand_in
import numpy as np
import pytest
from stored_waveform_runs import (
    BOTH_V,
    LONGEST,
    RAMP_V_PER_S,
    RATE_HZ,
    REST_V,
    assert_refused,
    axes_engine_of,
    of_y,
    pi_axes,
    played,
    settings,
    supervised,
)

from piezo_common.schema import checked
from piezo_stage_driver.backends import pi_gcs_stage, stored_waveforms
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.pi_gcs_stage import PiAxesSettings, PiController
from piezo_stage_driver.backends.stored_waveforms import StoredWaveformStage
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.safety.limits import LimitError
from piezo_stage_driver.safety.transitions import State


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(stored_waveforms.time, "sleep", lambda seconds: None)


@pytest.fixture
def controller():
    # The settings of y take two control values for 1 V, and 4 um for a unit of its position.
    return gcs_stand_in.Controller(um_per_v=(1.0, 0.25, 1.0), v_per_control=(1.0, 0.5, 1.0))


def stage_of(controller, **changes):
    told = checked(PiAxesSettings, pi_axes(**changes))
    return StoredWaveformStage(PiController(told, gcs_stand_in.library(controller)),
                               settings(own=of_y), LONGEST, 10.0)


@pytest.fixture
def stage(controller):
    stage = stage_of(controller)
    stage.open()
    return stage


def test_axes_play_and_are_recorded_together_each_in_its_own_units(controller, stage):
    assert stage.axes == ("x", "y")
    assert np.allclose(controller.held[:2], REST_V)
    voltage_v, displacement_um = played(axes_engine_of(stage), BOTH_V)
    assert np.allclose(voltage_v, BOTH_V)
    # The stand-in's stage has 1 um/V and shows each voltage one sample later.
    assert np.allclose(displacement_um[1:], BOTH_V[:-1], atol=1e-4)
    assert np.allclose(controller.held, [0.0, 5.0, 0.0])


def test_each_command_names_both_axes(controller, stage):
    played(axes_engine_of(stage), BOTH_V)
    told = [line for line in controller.commands if not line.startswith(("WAV ", "SVA "))]
    assert told == [
        "SVO 1 0 2 0", "WTR 1 10 0 2 10 0", "RTR 10", "DRC 1 1 2 2 2 2 3 1 7 4 2 7",
        "WCL 1 2", "WSL 1 1 2 2", "WGC 1 1 2 1", "WGO 1 1 2 1"]
    assert np.shape(controller.sent_v) == (len(controller.sent_v), 2)


def test_axes_are_at_rest_before_anything_is_played_each_by_its_ramp(controller):
    controller.held[:2] = 50.0
    stage_of(controller).open()
    sent_v = np.array([[50.0, 50.0], *(np.array(controller.sent_v) * [1.0, 0.5])])
    # The ramp of y takes longest: 45 V at 500 V/s in steps of 10 ms.
    assert len(sent_v) == 11 and np.allclose(sent_v[-1], REST_V)
    assert np.all(np.abs(np.diff(sent_v, axis=0)).max(axis=0) <= RAMP_V_PER_S * 0.01 + 1e-6)


def test_axis_that_rests_is_no_fault_while_the_other_plays(controller, stage):
    voltage_v = BOTH_V.copy()
    voltage_v[:, 1] = 5.0
    assert np.allclose(played(axes_engine_of(stage), voltage_v)[1][1:], voltage_v[:-1], atol=1e-4)


@pytest.mark.parametrize("column", [0, 1])
def test_voltage_of_one_axis_other_than_given_stops_both(controller, stage, column):
    scale = np.ones(3)
    scale[column] = 0.7
    controller.played_scale = scale
    controller.sent_v.clear()
    with pytest.raises(BackendFault, match=f"failed: {'xy'[column]}: its own record") as fault:
        played(axes_engine_of(stage), BOTH_V)
    assert fault.value.at_rest
    assert np.allclose(controller.held[:2], REST_V)
    assert "WGO 1 0 2 0" in controller.commands


def test_axis_that_moves_while_it_should_rest_stops_both(controller, stage):
    controller.played_scale = np.array([1.0, 3.0, 1.0])
    voltage_v = BOTH_V.copy()
    voltage_v[:, 1] = 5.0
    with pytest.raises(BackendFault, match="y: its own record of the voltage is 10 V RMS off"):
        played(axes_engine_of(stage), voltage_v)
    assert np.allclose(controller.held[:2], REST_V)


def test_stop_while_they_play_halts_both_and_ramps_both(controller, monkeypatch):
    monkeypatch.setattr(gcs_stand_in, "CYCLES_PER_QUESTION", 1000)
    supervisor, ends = supervised(stage_of(controller), axes_engine_of, BOTH_V)

    def press(seconds):
        if controller.running and controller.played > 200:
            supervisor.stop("somebody pressed the button")
    monkeypatch.setattr(stored_waveforms.time, "sleep", press)
    while supervisor.active:
        supervisor.tick()
    assert 200 < controller.played < 500 and not controller.running
    assert "WGO 1 0 2 0" in controller.commands
    assert np.allclose(controller.held[:2], REST_V)
    assert supervisor.state is State.FAULTED and supervisor.at_rest
    assert ends[0][0].startswith("somebody pressed")


@pytest.mark.parametrize(("column", "axis"), [(0, "x"), (1, "y")])
def test_lost_sensor_of_one_axis_stops_both_with_its_name(controller, monkeypatch, column, axis):
    monkeypatch.setattr(gcs_stand_in, "CYCLES_PER_QUESTION", 1000)
    supervisor, ends = supervised(stage_of(controller), axes_engine_of, BOTH_V)
    lost = np.where(np.arange(3) == column, 1e3, controller.um_per_v)

    def lose(seconds):
        if controller.running:
            controller.um_per_v = lost
    monkeypatch.setattr(stored_waveforms.time, "sleep", lose)
    for _ in range(4 * LONGEST // 10):
        supervisor.tick()
    assert ends[0][0].startswith(f"{axis}: the sensor reads ")
    assert supervisor.state is State.LATCHED and supervisor.at_rest
    assert np.allclose(controller.held[:2], REST_V)


def test_voltage_that_one_axis_must_not_play_is_refused_with_its_name(controller, stage):
    before = list(controller.commands)
    with pytest.raises(LimitError, match=r"y: voltage sample 0 is 51 V, outside \[0, 50\] V"):
        played(axes_engine_of(stage), [[50.0, 51.0]])
    assert controller.commands == before


def test_room_in_the_memory_is_that_of_the_slowest_return(stage):
    engine = axes_engine_of(stage)
    # 45 V at 500 V/s take 180 samples, 90 V at 2000 V/s 90; each counts for approach and return.
    engine.commands.play(np.tile([90.0, 50.0], 630), 1.0 / RATE_HZ, axes=("x", "y"))
    with pytest.raises(StageRefusal, match="the waveform takes 1010 samples with its ramps"):
        axes_engine_of(stage).commands.play(
            np.tile([90.0, 50.0], 640), 1.0 / RATE_HZ, axes=("x", "y"))


@pytest.mark.parametrize(("device", "changes", "sentence"), [
    ({"deaf_servo": True}, {}, "E-727: the servo of axis 1 stays on"),
    ({}, {"axis": "4"}, "E-727 has no axis 4, only 1, 2, 3: mend axis in the settings"),
    ({"tables": 3}, {}, "E-727 has 3 record tables, .* of each axis need 4: set more"),
    ({}, {"wave_generator": 4}, "pi_gcs cannot be opened: Parameter out of range"),
    ({}, {"output_channel": 4}, "pi_gcs cannot be opened: Invalid axis identifier"),
])
def test_what_the_controller_lacks_for_one_axis_is_refused_before_anything_moves(
        device, changes, sentence):
    controller = gcs_stand_in.Controller(**device)
    with pytest.raises(ValueError, match=sentence):
        stage_of(controller, **changes).open()
    assert not controller.sent_v and not controller.connected


def without_y(document):
    del document["axes"]["y"]


def without_generator(document):
    del document["axes"]["y"]["wave_generator"]


@pytest.mark.parametrize(("spoil", "sentence"), [
    (without_y, "axes has 1 entries; give at least 2"),
    (without_generator, r"axes\.y\.wave_generator is missing; add it"),
    (lambda document: document["axes"]["y"].update(wave_table=1),
     "axes name one wave_table twice; give each its own"),
    (lambda document: document["axes"]["y"].update(control_per_v=0.0),
     r"axes\.y\.control_per_v is 0; measure it"),
    (lambda document: document["axes"].update({"Y": document["axes"].pop("y")}),
     'axes has the name "Y"; give short ones such as x'),
])
def test_impossible_settings_of_axes_are_refused_in_one_sentence(tmp_path, spoil, sentence):
    document = pi_axes()
    spoil(document)
    assert_refused(pi_gcs_stage, document, tmp_path / "settings.yaml", sentence)
