# SPDX-License-Identifier: BSD-3-Clause
"""What a package imports from ROS and from the other packages, its package.xml names."""

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

PACKAGES = sorted(path.parent for path in Path(__file__).parents[1].glob("src/*/setup.py"))
ROS = re.compile(r"rclpy|ament_index_python|launch(_ros)?|\w+_(msgs|interfaces)|std_srvs|piezo_\w+")


def imported_packages(path):
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_imported_packages_are_named_in_the_manifest(package):
    modules = [*package.glob(f"{package.name}/**/*.py"), *package.glob("launch/*.py")]
    imported = {name for module in modules for name in imported_packages(module)}
    manifest = ElementTree.parse(package / "package.xml").getroot()
    named = {entry.text for tag in ("depend", "exec_depend") for entry in manifest.iter(tag)}
    assert {name for name in imported if ROS.fullmatch(name)} <= named | {package.name}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_manifest_and_setup_agree(package):
    manifest = ElementTree.parse(package / "package.xml").getroot()
    setup = (package / "setup.py").read_text()
    for tag in ("version", "description", "license"):
        assert f'{tag}="{manifest.findtext(tag)}"' in setup
