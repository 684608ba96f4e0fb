# SPDX-License-Identifier: BSD-3-Clause
"""The layers: models below, numerics on them, nodes on top, the simulator apart."""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"

# What the numerics of a package may import of the others; its nodes may import NODE_LAYER besides.
NUMERICS = {
    "piezo_models": set(),
    "piezo_recorder": set(),
    "piezo_stage_driver": {"piezo_models"},
    "piezo_sim": {"piezo_models", "piezo_stage_driver"},
    "piezo_identification": {"piezo_models", "piezo_recorder"},
    "piezo_controller": {"piezo_models", "piezo_recorder"},
    "piezo_ros": set(),
    "piezo_client": {"piezo_models", "piezo_recorder"},
}
# Packages that are of the node layer as a whole.
NODE_PACKAGES = {"piezo_ros", "piezo_client"}
NODE_LAYER = {"piezo_interfaces", "piezo_ros"}
ROS = re.compile(r"rclpy|rosidl_\w+|\w+_msgs|std_srvs|piezo_interfaces|piezo_ros")


def imported_names(path, package):
    """Yield (line, dotted name) of everything that a module of the package imports."""
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = [package, node.module] if node.level else [node.module]
            base = ".".join(part for part in parts if part)
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            yield from (
                (node.lineno, argument.value)
                for argument in node.args
                if isinstance(argument, ast.Constant)
            )


def is_node_layer(package, path):
    return package in NODE_PACKAGES or path.stem.endswith("_node")


def objection(package, path, name):
    """Say why a module of the package must not import the name, or return None."""
    other = name.split(".")[0]
    in_node_layer = is_node_layer(package, path)
    is_test = path.parent.name == "test"
    if not in_node_layer and not is_test:
        if ROS.fullmatch(other):
            return "only node modules use ROS"
        if re.search(r"^piezo_.*_node\b", name):
            return "only node modules import node modules"
    if package == "piezo_bringup":
        return None
    if other == "piezo_sim" and package != "piezo_sim":
        return "the models and the control must not see the simulated plant"
    allowed = NUMERICS[package] | {package} | (NODE_LAYER if in_node_layer or is_test else set())
    if other.startswith("piezo_") and other not in allowed:
        return f"{package} lies below or beside it"
    return None


def violations(source):
    """Return one line for each import under the source tree that breaks the layers."""
    found = []
    for path in sorted([*source.glob("*/piezo_*/**/*.py"), *source.glob("*/test/*.py")]):
        package = path.relative_to(source).parts[0]
        for line, name in imported_names(path, package):
            reason = objection(package, path, name)
            if reason:
                found.append(f"{path.relative_to(source)}:{line} imports {name}: {reason}")
    return found


def test_every_import_respects_the_layers():
    assert violations(SOURCE) == []


def test_every_python_package_has_its_layer():
    packages = {path.parent.name for path in SOURCE.glob("*/setup.py")}
    assert packages == NUMERICS.keys() | {"piezo_bringup"}


def write_module(source, package, module, code):
    folder = source / package / ("test" if module.startswith("test_") else package)
    folder.mkdir(parents=True)
    (folder / module).write_text(code)


@pytest.mark.parametrize(
    ("package", "module", "code"),
    [
        ("piezo_models", "preisach.py", "import rclpy.node"),
        ("piezo_models", "preisach.py", "from piezo_controller.feedback.synthesis.weights import load"),
        ("piezo_identification", "creep.py", "def f():\n    from rclpy import spin"),
        ("piezo_identification", "creep.py", "from piezo_sim.plant.plant import Plant"),
        ("piezo_identification", "a_node.py", "import piezo_sim"),
        ("piezo_identification", "test_creep.py", "from piezo_sim import plant"),
        ("piezo_identification", "creep.py", "from piezo_interfaces import msg"),
        ("piezo_identification", "creep.py", "import std_srvs.srv"),
        ("piezo_controller", "design.py", "from . import controller_node"),
        ("piezo_controller", "design.py", "from .controller_node import Controller"),
        ("piezo_controller", "design.py", "import_module('piezo_sim.plant.plant')"),
        ("piezo_controller", "design.py", "import piezo_identification.estimators.creep"),
        ("piezo_controller", "design.py", "from piezo_ros import spinning"),
        ("piezo_recorder", "reader.py", "from piezo_models import measures"),
        ("piezo_stage_driver", "engine.py", "from piezo_recorder import reader"),
        ("piezo_sim", "creep.py", "from piezo_identification import creep"),
        ("piezo_ros", "goals.py", "from piezo_controller import weights"),
        ("piezo_client", "stage.py", "from piezo_controller import weights"),
        ("piezo_controller", "a_node.py", "from piezo_client import stage"),
        ("piezo_bringup", "report.py", "import rclpy"),
    ],
)
def test_forbidden_import_is_found(tmp_path, package, module, code):
    write_module(tmp_path, package, module, code)
    assert len(violations(tmp_path)) == 1


@pytest.mark.parametrize(
    ("package", "module", "code"),
    [
        ("piezo_models", "cascade.py", "from .preisach import PreisachModel"),
        ("piezo_models", "cascade.py", "import numpy, scipy.signal, control"),
        ("piezo_identification", "a_node.py", "import rclpy"),
        ("piezo_identification", "a_node.py", "from piezo_ros import spinning"),
        ("piezo_identification", "creep.py", "from piezo_models import linear"),
        ("piezo_ros", "spinning.py", "import rclpy"),
        ("piezo_client", "stage.py", "from piezo_recorder import reader"),
        ("piezo_sim", "stage_sim_node.py", "from piezo_stage_driver import stage_node"),
        ("piezo_bringup", "demo_node.py", "import rclpy, piezo_sim.plant.plant"),
    ],
)
def test_allowed_import_is_not_objected_to(tmp_path, package, module, code):
    write_module(tmp_path, package, module, code)
    assert violations(tmp_path) == []
