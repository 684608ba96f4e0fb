# SPDX-License-Identifier: BSD-3-Clause
"""What README and docs tell to type can be typed: programs, arguments, fields and names exist.

Commands of ours are run as far as their arguments are taken; what they then do has tests of its
own, of which COVERED names those of the long ones. Commands of ROS, which are not part of the
wheels, are compared with launch files, interfaces and nodes.
"""

import argparse
import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for path in [*ROOT.glob("*.md"), *ROOT.glob("test/README.md"),
                                 *ROOT.glob("docs/**/*.md")] if path.name != "errors.md")
COVERED = {
    "make demo": "src/piezo_studies/test/demo/test_demo_summary.py",
    "make test": "test/test_package_manifests.py",
    "make extras": "test/test_documented_commands.py",
    "make setup": "test/test_documented_commands.py",
    "make bench": "src/piezo_identification/test/test_simulation_study.py",
    "make reproduce": "src/piezo_studies/test/thesis/test_reproduction.py",
    "make measured": "src/piezo_studies/test/measured_devices/test_measured_command.py",
    "make diagnose-suite": "src/piezo_studies/test/diagnosis_benchmark/test_diagnose_suite.py",
    "make twins": "src/piezo_studies/test/diagnosis_benchmark/test_twin_decisions.py",
    "make calibration": "src/piezo_studies/test/diagnosis_benchmark/test_short_cases.py",
    "make tables": "test/test_error_table.py",
    "make gallery": "test/test_front_door.py",
    "make style": "test/test_package_manifests.py",
    "make docs": "test/test_package_manifests.py",
    "make long": "test/test_bad_input.py",
    "make quick": "test/test_kernels.py",
    "make kernels": "test/test_kernels.py",
    "make mutants": "test/test_mutation_check.py",
    "make test-repeat": "test/test_documented_commands.py",
    "make coverage": "test/test_kernels.py",
}
# Of programs that are not ours, or that need a device.
NOT_OURS = ("source ", "pip install", "pre-commit ", "ros2 bag", "ros2 lifecycle", "ros2 param",
            "ros2 service", "ros2 topic", "ros2 interface", "ros2 security", "git clone", "cd ")


class Parsed(Exception):
    """A command has taken its arguments."""


def blocks(page, *languages):
    """Contents of the fenced blocks of some languages."""
    for language, content in re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.M | re.S):
        if language in languages:
            yield content


def commands():
    """Every command of every page, with continued lines joined and comments taken off."""
    for page in PAGES:
        for content in blocks(page, "", "bash"):
            joined = content.replace("\\\n", " ")
            if joined.count('"') % 2 == 0:
                joined = re.sub(r'"[^"]*"', lambda match: match[0].replace("\n", " "), joined)
            for line in joined.splitlines():
                command = re.sub(r"\s+#.*", "", line).strip()
                if re.match(r"(\./|\.venv/|(make|ros2|source|pip|git|cd|python)\b)", command):
                    yield pytest.param(command, id=f"{page.name}: {command[:60]}")


def entry_point(package, executable):
    """The main function of an executable, or fail."""
    setup = (ROOT / "src" / package / "setup.py").read_text()
    module = re.search(rf'"{executable} = ([\w.]+):main"', setup)
    assert module, f"{package} has no executable {executable}"
    return importlib.import_module(module[1]).main


def assert_parses(main, arguments, monkeypatch):
    parse_args = argparse.ArgumentParser.parse_args

    def parse(parser, *given):
        parse_args(parser, *given)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
    with pytest.raises(Parsed):
        main(arguments)


def assert_declared(ros_arguments):
    """Some node declares each parameter that is given."""
    sources = "".join(path.read_text() for path in ROOT.glob("src/*/piezo_*/**/*.py"))
    for name in re.findall(r"-p (\w+):=", " ".join(ros_arguments)):
        assert f'"{name}"' in sources, f"no node declares {name}"


def assert_launches(launch_file, arguments):
    folder = ROOT / "src" / "piezo_bringup" / "launch"
    text = (folder / launch_file).read_text() + (folder / "stage.launch.py").read_text()
    for argument in arguments:
        name = argument.split(":=")[0]
        assert re.search(rf'DeclareLaunchArgument\(\s*"{name}"', text), (
            f"{launch_file} takes no {name}")


def fill(message, values):
    """Set fields of a message; it objects itself to a wrong type."""
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            assert hasattr(message, name), name
            setattr(message, name, value)


def assert_is_goal(name, type_name, text):
    """The fields of a goal are those of its action, which a node serves under this name."""
    goal = getattr(importlib.import_module("piezo_interfaces.action"),
                   type_name.rsplit("/", 1)[1]).Goal()
    fill(goal, yaml.safe_load(text))
    sources = "".join(path.read_text() for path in ROOT.glob("src/*/piezo_*/**/*_node.py"))
    assert f'"{name.lstrip("/")}"' in sources, f"nobody serves {name}"


@pytest.mark.parametrize("command", list(commands()))
def test_command_can_be_typed(command, monkeypatch):
    words = shlex.split(command)
    if command.startswith("make"):
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.M)
        covered = COVERED.get(" ".join(words[:2]))
        assert covered and (ROOT / covered).is_file(), "name its test in COVERED"
    elif words[0] == "./run" or words[:2] == ["ros2", "run"]:
        package, executable, *arguments = words[1:] if words[0] == "./run" else words[2:]
        main = entry_point(package, executable)
        if "--ros-args" in arguments or not arguments and main.__module__.endswith("_node"):
            assert_declared(arguments)
        else:
            assert_parses(main, arguments, monkeypatch)
    elif words[:3] == ["ros2", "launch", "piezo_bringup"]:
        assert_launches(words[3], words[4:])
    elif words[:3] == ["ros2", "action", "send_goal"]:
        assert_is_goal(*[word for word in words[3:] if word != "--feedback"])
    elif words[0] == ".venv/bin/python" and len(words) > 1:
        assert (ROOT / words[3 if words[1:3] == ["-m", "pytest"] else 1]).is_file()
    else:
        assert command.startswith(NOT_OURS) or words == [".venv/bin/python"], command


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_of_a_page_compiles_and_finds_what_it_imports(page):
    for content in blocks(page, "python"):
        for node in ast.parse(content).body:
            if isinstance(node, ast.ImportFrom) and node.module.startswith("piezo_"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names), node.module


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_picture_and_link_of_a_page_exists(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_picture_has_the_command_that_makes_it_beside_it(page):
    text = page.read_text()
    if "![" in text and not text.splitlines()[2].startswith("Written by `make"):
        for match in re.finditer(r"!\[[^\]]*\]\([^)]*\)", text):
            beside = text[max(0, match.start() - 800):match.end() + 800]
            assert re.search(r"`(make [\w-]+|\./run piezo_[^`]*)`", beside), match[0]
