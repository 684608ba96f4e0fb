# SPDX-License-Identifier: BSD-3-Clause
"""The launch files start executables that exist, with arguments that are declared.

They are read, not run: `launch` is part of a ROS installation and not of the wheels.
"""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2]
LAUNCH_FILES = sorted(SOURCE.glob("piezo_bringup/launch/*.launch.py"))


def calls(path, name):
    """Yield the keyword and positional arguments of every call of a function, as source text."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == name:
            yield ([ast.unparse(value) for value in node.args],
                   {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords})


def executables(package):
    setup = (SOURCE / package / "setup.py").read_text()
    return re.findall(r'"(\w+) = [\w.]+:\w+"', setup)


def declared(path):
    """Return the default of every launch argument of a file and of the one it includes."""
    arguments = {ast.literal_eval(values[0]): options["default_value"]
                 for values, options in calls(path, "DeclareLaunchArgument")}
    if path.name != "stage.launch.py" and "stage.launch.py" in path.read_text():
        arguments |= declared(path.with_name("stage.launch.py"))
    return arguments


def test_the_launch_files_are_those_of_the_docs():
    assert [path.name for path in LAUNCH_FILES] == [
        "closed_loop.launch.py", "identify.launch.py", "stage.launch.py"]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.stem)
def test_every_node_is_an_executable_of_its_package(path):
    arguments = declared(path)
    nodes = list(calls(path, "Node"))
    assert nodes
    for _, options in nodes:
        package, executable = (
            ast.literal_eval(re.sub(r"LaunchConfiguration\('(\w+)'\)",
                                    lambda match: arguments[match[1]], options[key]))
            for key in ("package", "executable"))
        assert executable in executables(package)


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.stem)
def test_every_argument_used_is_declared_and_described(path):
    used = {ast.literal_eval(values[0]) for values, _ in calls(path, "LaunchConfiguration")}
    assert used <= declared(path).keys()
    for _, options in calls(path, "DeclareLaunchArgument"):
        assert ast.literal_eval(options["description"]).endswith(".")


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.stem)
def test_every_file_of_a_package_is_there(path):
    for match in re.findall(
            r"FindPackageShare\('(\w+)'\), '(\w+)', '([\w.]+)'", ast.unparse(
                ast.parse(path.read_text()))):
        assert SOURCE.joinpath(*match).is_file()


def test_profiles_are_files_of_the_package():
    text = LAUNCH_FILES[2].read_text()
    assert "'config', [LaunchConfiguration('profile'), '.yaml']" in ast.unparse(ast.parse(text))
    for name in "simulated_stage", "simulated_axes", "hardware":
        assert name in text
        assert (SOURCE / "piezo_bringup" / "config" / f"{name}.yaml").is_file()


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.stem)
def test_every_node_of_a_parameter_file_gets_the_data_root_before_it(path):
    """What the file says of it counts more, as it comes later."""
    lists = re.findall(r"parameters[\"=: ]+\[(.*?)\]", path.read_text())
    assert lists
    assert set(lists) == {'data_root, LaunchConfiguration("parameters")'}
    assert "data_root" in declared(path)
