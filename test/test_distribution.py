# SPDX-License-Identifier: BSD-3-Clause
"""The distribution at the root: what it asks for, what it holds, and that its command works."""

import os
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from importlib import metadata
from itertools import chain
from pathlib import Path

import pytest
from imported_packages import imported_packages
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HALF = {"piezo_common", "piezo_models", "piezo_recorder", "piezo_identification",
        "piezo_controller", "piezo_offline"}
OF_ROS = {"ament_index_python"}
"""Imported where ROS is there, and done without where it is not."""


def asked_for():
    project = PROJECT["project"]
    extras = chain.from_iterable(project["optional-dependencies"].values())
    return [Requirement(each) for each in [*project["dependencies"], *extras]]


def imported_libraries():
    """Top names of what the modules of the distribution import, but for ours and Python's own."""
    for package in sorted(HALF):
        for path in (ROOT / "src" / package / package).rglob("*.py"):
            if path.parent.name == "node":
                continue
            for name in imported_packages(path):
                yield name, path


def test_it_asks_for_every_library_that_it_imports():
    homes = metadata.packages_distributions()
    declared = {canonicalize_name(requirement.name) for requirement in asked_for()}
    missing = {
        (name, path.name) for name, path in imported_libraries()
        if name not in HALF and name not in sys.stdlib_module_names and name not in OF_ROS
        and not declared & {canonicalize_name(home) for home in homes.get(name, [name])}}
    assert missing == set()


@pytest.mark.parametrize("lock", ["wheels-extras", "jazzy-extras"])
def test_what_it_asks_for_is_locked_within_its_ranges(lock):
    lines = (ROOT / "requirements" / f"{lock}.lock").read_text(encoding="utf-8").splitlines()
    locked = dict(line.split("==") for line in lines if "==" in line and line[0] != "#")
    for requirement in asked_for():
        assert requirement.specifier.contains(locked[requirement.name]), requirement


def test_it_holds_the_packages_that_its_command_needs_and_no_node():
    find = PROJECT["tool"]["setuptools"]["packages"]["find"]
    assert {Path(where).name for where in find["where"]} == HALF
    assert find["exclude"] == ["*.node", "*.node.*"]


def test_colcon_takes_the_root_for_no_package():
    identification = pytest.importorskip("colcon_core.package_identification")
    extensions = identification.get_package_identification_extensions()
    assert identification.identify(extensions, ROOT) is None
    found = identification.identify(extensions, ROOT / "src" / "piezo_offline")
    assert (found.name, found.type) == ("piezo_offline", "ros.ament_python")


@pytest.mark.long
def test_wheel_and_sdist_build_and_the_command_works_where_nothing_else_of_ours_is(tmp_path):
    # Of what git has, as anybody gets it, so that nothing that was built before is in it.
    source = tmp_path / "source"
    files = subprocess.run(["git", "-C", ROOT, "ls-files", "-z"], capture_output=True, check=True)
    for name in filter(None, files.stdout.decode().split("\0")):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_bytes((ROOT / name).read_bytes())
    build = "from setuptools.build_meta import *; print(build_{}({!r}))"
    for kind in "sdist", "wheel":
        subprocess.run([sys.executable, "-c", build.format(kind, str(tmp_path))], cwd=source,
                       check=True, capture_output=True)
    wheel, = tmp_path.glob("*.whl")
    assert len(list(tmp_path.glob("*.tar.gz"))) == 1
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == HALF
    assert not [name for name in names if "/node/" in name or "/test/" in name]

    # The libraries are those of this environment, our packages those of the wheel alone.
    venv.create(tmp_path / "clean", symlinks=True)
    library = tmp_path / "clean" / Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
    zipfile.ZipFile(wheel).extractall(library)
    (library / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    table = tmp_path / "mine.csv"
    table.write_text("time_s,voltage_v,displacement_um\n" + "".join(
        f"{k * 0.001:.3f},{k % 7},{k % 5}\n" for k in range(500)))
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def piezo(*arguments):
        return subprocess.run(
            [tmp_path / "clean" / "bin" / "python", "-m", "piezo_offline.piezo_command",
             *arguments], env=environment, cwd=tmp_path, capture_output=True, text=True)

    done = piezo("convert", "mine.csv", "mine")
    assert done.returncode == 0, done.stderr
    report = piezo("report", "mine")
    assert (report.returncode, "500 samples" in report.stdout) == (0, True), report.stderr
    assert piezo("design", "--help").returncode == 0
