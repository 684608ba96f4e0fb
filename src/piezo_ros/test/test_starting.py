# SPDX-License-Identifier: BSD-3-Clause
"""An executable of a node answers help and mistyped arguments before the node is imported."""

import sys

import pytest
from rclpy.utilities import remove_ros_args

from piezo_ros.starting import arguments_set, node_entry, without_ros_arguments


@pytest.mark.parametrize("arguments", [
    [], ["--model", "m"], ["--ros-args", "-p", "a:=1"], ["x", "--ros-args", "-r", "__ns:=/a"],
    ["--ros-args", "-p", "a:=1", "--", "y"], ["--ros-args", "--", "x", "--ros-args", "-p", "b:=2"]])
def test_arguments_of_ros_are_those_that_ros_itself_takes(arguments):
    assert without_ros_arguments(arguments) == remove_ros_args(["name", *arguments])[1:]


@pytest.mark.parametrize(("arguments", "status"), [
    (["--help"], 0), (["--backend", "nidaqmx"], 2), (["-p", "backend:=nidaqmx"], 2)])
def test_help_and_typos_import_no_node(arguments, status, capsys):
    entry = node_entry("no_such_package.some_node", "Do something.")
    with pytest.raises(SystemExit) as ended:
        entry(arguments)
    assert ended.value.code == status
    printed = capsys.readouterr()
    assert "--ros-args" in printed.out + printed.err
    assert "no_such_package" not in sys.modules


@pytest.mark.parametrize(("given", "expected"), [
    (["-p", "timing:=lockstep"], True), (["-p", "stage:timing:='lockstep'"], True), ([], False),
    (["-p", "timing:=paced", "-p", "lockstep_timeout_s:=2.0"], False)])
def test_arguments_tell_what_a_parameter_is_set_to(given, expected):
    assert arguments_set("timing", "lockstep", ["stage", "--ros-args", *given]) is expected


@pytest.mark.parametrize(("text", "expected"), [
    ("/**:\n  ros__parameters:\n    timing: lockstep\n", True),
    ("stage:\n  ros__parameters: {timing: 'lockstep'}\n", True),
    ("stage:\n  ros__parameters: {timing: paced, lockstep_timeout_s: 2.0}\n", False)])
def test_parameter_files_tell_what_a_parameter_is_set_to(text, expected, tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    arguments = ["stage", "--ros-args", "--params-file", str(file), "--params-file", "missing.yaml"]
    assert arguments_set("timing", "lockstep", arguments) is expected
