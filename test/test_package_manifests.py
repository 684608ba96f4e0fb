# SPDX-License-Identifier: BSD-3-Clause
"""What a package imports from ROS and from the other packages, its package.xml names."""

import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
from imported_packages import imported_packages

PACKAGES = sorted(path.parent for path in Path(__file__).parents[1].glob("src/*/setup.py"))
# What rosdep knows, by its key; what comes from PyPI is named in a comment.
ROSDEP = {name: f"python3-{name}"
          for name in ("matplotlib", "numba", "numpy", "scipy", "sklearn", "yaml")}
PYPI = {"bokeh", "control", "dask", "distributed", "h5py", "mcap", "nidaqmx", "nptdms", "pandas",
        "pyarrow", "pydantic", "rosbags", "shtab", "slycot", "threadpoolctl"}
ROS = re.compile(r"rclpy|ament_index_python|launch(_ros)?|\w+_(msgs|interfaces)|std_srvs|piezo_\w+")


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_imported_packages_are_named_in_the_manifest(package):
    modules = [*package.glob(f"{package.name}/**/*.py"), *package.glob("launch/*.py")]
    imported = {name for module in modules for name in imported_packages(module)}
    manifest = ElementTree.parse(package / "package.xml").getroot()
    named = {entry.text for tag in ("depend", "exec_depend") for entry in manifest.iter(tag)}
    assert {name for name in imported if ROS.fullmatch(name)} <= named | {package.name}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_libraries_are_named_in_the_manifest(package):
    imported = {name for module in package.glob(f"{package.name}/**/*.py")
                for name in imported_packages(module)}
    manifest = (package / "package.xml").read_text()
    keys = {f"<exec_depend>{ROSDEP[name]}</exec_depend>" for name in imported & ROSDEP.keys()}
    assert {key for key in keys if key not in manifest} == set()
    comments = " ".join(re.findall("<!--(.*?)-->", manifest, re.S))
    assert {name for name in imported & PYPI if name not in comments} == set()


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_manifest_and_setup_agree(package):
    manifest = ElementTree.parse(package / "package.xml").getroot()
    setup = (package / "setup.py").read_text()
    for tag in ("version", "description", "license"):
        assert f'{tag}="{manifest.findtext(tag)}"' in setup


def test_every_package_has_its_layer_and_its_api_page():
    root = Path(__file__).parents[1]
    names = {package.name for package in PACKAGES}
    layers = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]
    assert set(layers["root_packages"]) == names
    assert set(re.findall(r"piezo_\w+", " ".join(layers["contracts"][0]["layers"]))) == names
    pages = (root / "docs" / "api" / "index.rst").read_text()
    assert set(re.findall(r"^   (\w+)$", pages, re.M)) == names
