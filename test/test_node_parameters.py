# SPDX-License-Identifier: BSD-3-Clause
"""Every parameter is described; a bad one keeps its node from starting, in one line."""

import os
import re
import signal
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_prefix
from forked_processes import ForkedProcesses
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters

from piezo_bringup.processes import EXECUTABLES
from piezo_controller.tracking.feedbacks import FeedbackSettings
from piezo_identification.experiments.catalogue import EXPERIMENTS, named_experiment
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_stage_driver.node import stage_node
from piezo_stage_driver.node.stage_settings import StageSettings

CALIBRATION = (Path(__file__).parents[1]
               / "src/piezo_stage_driver/config/nidaqmx_calibration.yaml")
HARDWARE = Path(__file__).parents[1] / "src/piezo_bringup/config/hardware.yaml"
# Of rclpy itself.
NOT_OURS = {"use_sim_time", "start_type_description_service"}

# As descriptions bear it: "Rate of the sample clock (Hz)."
UNIT = re.compile(r"\((V|V/s|Hz|1/h|s|um|percent)( RMS)?\)")


@pytest.mark.parametrize("node", EXECUTABLES)
def test_every_parameter_has_a_description_a_range_and_a_unit(serving, node):
    suite = serving(node)
    names = suite.call(ListParameters, f"{node}/list_parameters").result.names
    assert "autostart" in names
    descriptors = suite.call(
        DescribeParameters, f"{node}/describe_parameters", names=names).descriptors
    undescribed = {d.name for d in descriptors if not d.description.endswith(".")}
    assert undescribed <= NOT_OURS
    assert [d.name for d in descriptors
            if d.type == ParameterType.PARAMETER_DOUBLE and not (
                d.floating_point_range and UNIT.search(d.description))] == []
    assert [d.name for d in descriptors
            if d.type == ParameterType.PARAMETER_INTEGER and not d.integer_range] == []


@pytest.mark.parametrize(("node", "parameters", "line"), [
    ("stage", {"sample_rate_hz": 5.0},
     "parameter sample_rate_hz is out of range: give a value from 10 to 200000"),
    ("stage", {"sample_rate_hz": 40000},
     "parameter sample_rate_hz is no float: give a value such as 40000.0"),
    ("stage", {"timing": "slow"}, "parameter timing is 'slow': give paced or lockstep"),
    ("controller", {"feedback_place": "inside"},
     "parameter feedback_place is 'inside': give before_inverse or behind_inverse"),
    ("stage", {"autostart": True, "plant": "/no/plant.yaml"},
     "/no/plant.yaml: the plant file cannot be read"),
    ("recorder", {"topics": "[samples]"}, "names 1 topics, types 7"),
])
def test_bad_parameter_ends_the_node_at_start_with_one_clear_line(
        node, parameters, line, tmp_path):
    with ForkedProcesses(tmp_path) as processes:
        processes.start(node, parameters)
        assert processes.process(node).wait(300.0) == 2
    assert_said_once(line, processes.log(node).read_text())


@pytest.mark.parametrize(("arguments", "line"), [
    (["-p", "autostart:=true", "-p", f"backend_file:={CALIBRATION}"],
     "the backend nidaqmx needs the Python package nidaqmx"),
    (["-p", "autostart:=true"], "set the parameter backend_file"),
    (["-p", "backend:=mine"], "there is no backend 'mine': set the parameter backend"),
])
def test_stage_without_its_backend_ends_with_one_clear_line(arguments, line, tmp_path):
    with ForkedProcesses(tmp_path) as processes:
        processes.start_main("stage", stage_node.main, ["--ros-args", *arguments])
        assert processes.process("stage").wait(300.0) == 2
    assert_said_once(line, processes.log("stage").read_text())


def test_executable_that_cannot_start_ends_with_one_clear_line():
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    recorder = Path(get_package_prefix("piezo_recorder"), "lib", "piezo_recorder", "recorder")
    ended = subprocess.run(
        [recorder, "--ros-args", "--params-file", "/no/parameters.yaml"],
        env=environment, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 2
    assert_said_once(
        "Couldn't parse params file: '--params-file /no/parameters.yaml'", ended.stderr)


def assert_said_once(line, printed):
    assert len([text for text in printed.splitlines() if line in text]) == 1
    assert "Traceback" not in printed


def test_stage_with_the_profile_for_hardware_waits_unconfigured_and_says_how_to_go_on():
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    package = "piezo_stage_driver"
    executable = Path(get_package_prefix(package), "lib", package, "stage")
    arguments = "--ros-args", "--params-file", HARDWARE, "-r", "__ns:=/bare"
    with subprocess.Popen([executable, *arguments], env=environment, stderr=subprocess.PIPE,
                          text=True) as process:
        said = next(line for line in process.stderr if "unconfigured" in line)
        process.send_signal(signal.SIGINT)
    assert "ros2 lifecycle set /bare/stage configure" in said
    assert "autostart:=true" in said


def test_profile_for_hardware_sets_parameters_that_exist_and_fits_every_experiment():
    profile = yaml.safe_load(HARDWARE.read_text())
    stage, controller = (profile[f"/**/{name}"]["ros__parameters"]
                         for name in ("stage", "controller"))
    described = get_type_hints(StageSettings)
    assert stage.keys() - {"backend", "autostart"} <= described.keys()
    assert controller.keys() <= {field.name for field in fields(FeedbackSettings)}
    assert stage["slew_limit_v_per_s"] <= 1e5 and stage["autostart"] is False
    limits = StageLimits(
        stage["minimum_voltage_v"], stage["maximum_voltage_v"], stage["slew_limit_v_per_s"])
    for name in EXPERIMENTS:
        experiment = named_experiment(name, limits)
        assert np.abs(np.diff(experiment.voltage_v)).max() <= 2.5 * (1.0 + 1e-9)
