# SPDX-License-Identifier: BSD-3-Clause
"""The layers: models below, numerics on them, nodes on top, the simulator apart."""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"

# What the numerics of a package may import of the others; its nodes may import NODE_LAYER besides.
NUMERICS = {
    "piezo_common": set(),
    "piezo_models": {"piezo_common"},
    "piezo_recorder": {"piezo_common"},
    "piezo_stage_driver": {"piezo_common", "piezo_models"},
    "piezo_sim": {"piezo_common", "piezo_stage_driver"},
    "piezo_identification": {"piezo_common", "piezo_models", "piezo_recorder"},
    "piezo_controller": {"piezo_common", "piezo_models", "piezo_recorder"},
    "piezo_offline": {"piezo_common", "piezo_models", "piezo_recorder", "piezo_identification",
                      "piezo_controller"},
    "piezo_ros": {"piezo_common"},
    "piezo_client": {"piezo_common", "piezo_models", "piezo_recorder"},
    "piezo_bringup": {"piezo_common", "piezo_client", "piezo_ros"},
}
# Packages that are of the node layer as a whole.
NODE_PACKAGES = {"piezo_ros", "piezo_client", "piezo_bringup"}
NODE_LAYER = {"piezo_interfaces", "piezo_ros"}
# Above all others: it may import what it likes, but only its nodes may import ROS.
TOP = "piezo_studies"
# Tests of every package may check a method against the slow but simple one.
BASELINES = "piezo_studies.baselines"
MOST_MODULES = 16
# Rooms that are open lists: each entry is one module.
CATALOGUES = {"effects", "thesis"}
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
    return (package in NODE_PACKAGES or path.parent.name == "node"
            or path.stem.endswith("_node"))


def objection(package, path, name):
    """Say why a module of the package must not import the name, or return None."""
    other = name.split(".")[0]
    in_node_layer = is_node_layer(package, path)
    is_test = "test" in path.parts
    if not in_node_layer and not is_test:
        if ROS.fullmatch(other):
            return "only node modules use ROS"
        if re.search(r"^piezo_\w+\.(.+\.)?node\b|^piezo_.*_node\b", name):
            return "only node modules import node modules"
    if package == TOP or (is_test and name.startswith(BASELINES)):
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
    for path in sorted([*source.glob("*/piezo_*/**/*.py"), *source.glob("*/test/**/*.py")]):
        package = path.relative_to(source).parts[0]
        inside = path.relative_to(source)
        for line, name in imported_names(path, package):
            reason = objection(package, inside, name)
            if reason:
                found.append(f"{inside}:{line} imports {name}: {reason}")
    return found


def test_every_import_respects_the_layers():
    assert violations(SOURCE) == []


def test_every_python_package_has_its_layer():
    packages = {path.parent.name for path in SOURCE.glob("*/setup.py")}
    assert packages == NUMERICS.keys() | {TOP}


def test_no_room_is_crowded():
    rooms = {path.parent for path in SOURCE.glob("*/piezo_*/**/*.py")}
    modules = {room: [path for path in room.glob("*.py") if path.name != "__init__.py"]
               for room in rooms}
    assert {str(room) for room, held in modules.items()
            if len(held) > MOST_MODULES and room.name not in CATALOGUES} == set()


def write_module(source, package, module, code):
    path = source / package / ("test" if "test_" in module else package) / module
    path.parent.mkdir(parents=True)
    path.write_text(code)


@pytest.mark.parametrize(
    ("package", "module", "code"),
    [
        ("piezo_models", "preisach.py", "import rclpy.node"),
        ("piezo_models", "preisach.py", "from piezo_controller.feedback import robustness"),
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
        ("piezo_bringup", "suite_command.py", "from piezo_studies.demo import summary"),
        ("piezo_studies", "demo/report.py", "import rclpy"),
        ("piezo_sim", "plant/creep.py", "from piezo_models import linear"),
        ("piezo_common", "text_file.py", "from piezo_models import linear"),
        ("piezo_controller", "feedback/loop.py", "import piezo_controller.node"),
        ("piezo_identification", "test/room/test_creep.py", "from piezo_sim import plant"),
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
        ("piezo_models", "test_preisach.py", "import piezo_studies.baselines.relay_grid"),
        ("piezo_client", "stage.py", "from piezo_recorder import reader"),
        ("piezo_sim", "stage_sim_node.py", "from piezo_stage_driver import stage_node"),
        ("piezo_studies", "demo/demo_node.py", "import rclpy, piezo_sim.plant.plant"),
        ("piezo_stage_driver", "node/stage_outputs.py", "import rclpy"),
    ],
)
def test_allowed_import_is_not_objected_to(tmp_path, package, module, code):
    write_module(tmp_path, package, module, code)
    assert violations(tmp_path) == []
