# SPDX-License-Identifier: BSD-3-Clause
"""Help, and the refusal of a mistyped option or path, wait for no library of numerics or of ROS."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from piezo_common.command_line import Command

ROOT = Path(__file__).parents[1]
HEAVY = {"bokeh", "control", "dask", "distributed", "h5py", "matplotlib", "mcap", "numba", "numpy",
         "pandas", "pydantic", "rclpy", "rosbags", "scipy", "slycot", "yaml"}
MODULES = {
    f"{path.parent.name} {name}": module
    for path in sorted(ROOT.glob("src/*/setup.py"))
    for name, module in re.findall(r'"(\w+) = ([\w.]+):main"', path.read_text(encoding="utf-8"))}
COMMANDS = {title: importlib.import_module(module).COMMAND for title, module in MODULES.items()
            if hasattr(importlib.import_module(module), "COMMAND")}
"""Those that are a `Command`; the others parse their options themselves."""


def loaded_by(*calls, first=""):
    """Heavy modules that a process has loaded after it called main functions with arguments."""
    lines = [f"try: importlib.import_module({module!r}).main({arguments!r})\n"
             "except SystemExit: pass" for module, arguments in calls]
    script = "\n".join(["import importlib, sys", first, *lines,
                        f"print('loaded', *sorted({HEAVY!r} & sys.modules.keys()))"])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1].split()[1:], done


def test_help_of_all_commands_loads_no_heavy_module():
    loaded, done = loaded_by(*((module, ["--help"]) for module in MODULES.values()))
    assert loaded == []
    assert done.stdout.count("usage: ") == len(MODULES)


def test_mistyped_option_or_path_is_refused_without_a_heavy_module():
    calls = [(module, ["--no-such-option"]) for module in MODULES.values()]
    calls.append((MODULES["piezo_client stage"], [
        "play", "no_such_table.csv", "--output", "unused"]))
    calls.append((MODULES["piezo_identification diagnose"], [
        "--model", "no_such_file", "--data", "none", "--output", "unused"]))
    calls.append((MODULES["piezo_identification identify"], ["--output", "no/such/folder/model"]))
    loaded, done = loaded_by(*calls)
    assert loaded == []
    assert "diagnose: no_such_file does not exist" in done.stderr
    assert "stage: no_such_table.csv does not exist" in done.stderr
    assert "identify: no/such/folder/model is no file in an existing directory" in done.stderr
    refusals = re.findall("unrecognized arguments|arguments are required", done.stderr)
    assert len(refusals) == len(MODULES)


def test_what_drives_a_stage_loads_no_library_of_models_or_pictures():
    loaded, _ = loaded_by(first="import piezo_client.stage_work")
    assert not {"control", "matplotlib", "numba", "pandas", "scipy"} & set(loaded)


def test_a_heavy_module_that_is_loaded_is_seen():
    assert {"numpy", "scipy"} <= set(loaded_by(first="import scipy")[0])


@pytest.mark.parametrize("title", COMMANDS)
def test_work_and_inputs_of_a_command_exist(title):
    command = COMMANDS[title]
    module, function = command.work.split(":")
    assert callable(getattr(importlib.import_module(module), function))
    names = {action.dest for action in command.parser()._actions}
    assert set(command.inputs) <= names


def test_interrupted_command_says_what_stays(capsys, monkeypatch):
    def interrupt(options):
        raise KeyboardInterrupt

    command = Command("mend", "Mend.", lambda parser: None, "os:getcwd",
                      interrupted="the pieces stay")
    monkeypatch.setattr(Command, "_load", lambda command: interrupt)
    assert command.main([]) == 130
    assert capsys.readouterr().err == "mend: interrupted; the pieces stay\n"
