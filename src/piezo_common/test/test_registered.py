# SPDX-License-Identifier: BSD-3-Clause
"""Packages that are installed beside the suite add to its open lists, and only to those."""

import sys
import textwrap

import pytest

from piezo_common.registered import registered

GROUP = "piezo_test.shapes"


class Circle:
    name = "circle"


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a module with entry points on the path, as pip would."""
    def put(module, code, **points):
        directory = tmp_path / module
        metadata = directory / f"{module}-1.0.dist-info"
        metadata.mkdir(parents=True)
        (directory / f"{module}.py").write_text(textwrap.dedent(code))
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[{GROUP}]\n" + "".join(
            f"{name} = {target}\n" for name, target in points.items()))
        monkeypatch.syspath_prepend(directory)
        monkeypatch.delitem(sys.modules, module, raising=False)
        return directory

    yield put
    for name in ("lab_shapes", "other_shapes", "broken_shapes"):
        sys.modules.pop(name, None)


def test_own_objects_come_first_and_those_of_other_packages_after_them(install):
    install("lab_shapes", "class Square: name = 'square'\n", square="lab_shapes:Square")
    known = registered(GROUP, {"circle": Circle})
    assert list(known) == ["circle", "square"]
    assert known["circle"] is Circle
    assert known["square"].__module__ == "lab_shapes"
    assert "square" in known and "triangle" not in known
    assert len(known) == 2
    with pytest.raises(KeyError):
        known["triangle"]


def test_function_without_a_name_of_its_own_is_found_by_its_entry_point(install):
    install("lab_shapes", "def square():\n    return 4\n", square="lab_shapes:square")
    assert registered(GROUP)["square"]() == 4


def test_broken_package_disturbs_only_those_who_ask_for_it(install):
    install("broken_shapes", "import no_such_library\n", star="broken_shapes:Star")
    known = registered(GROUP, {"circle": Circle})
    assert known["circle"] is Circle
    with pytest.raises(ValueError, match="shape 'star' cannot be loaded: .*no_such_library"):
        known["star"]


def test_missing_object_of_a_module_is_told_in_one_line(install):
    install("lab_shapes", "", square="lab_shapes:Square")
    with pytest.raises(ValueError, match="'square' cannot be loaded: .*'Square'"):
        registered(GROUP)["square"]


def test_object_that_bears_another_name_is_refused(install):
    install("lab_shapes", "class Square: name = 'quadrat'\n", square="lab_shapes:Square")
    with pytest.raises(ValueError, match="'square' calls itself 'quadrat'"):
        registered(GROUP)["square"]


def test_two_objects_of_one_name_are_refused(install):
    install("lab_shapes", "class Square: name = 'square'\n", square="lab_shapes:Square")
    with pytest.raises(ValueError, match="two shapes are named square"):
        registered(GROUP, {"square": Circle})
    install("other_shapes", "class Square: name = 'square'\n", square="other_shapes:Square")
    with pytest.raises(ValueError, match="two shapes are named square"):
        registered(GROUP)


def test_package_that_is_found_twice_on_the_path_counts_once(install, monkeypatch):
    directory = install("lab_shapes", "class Square: name = 'square'\n",
                        square="lab_shapes:Square")
    monkeypatch.syspath_prepend(directory)
    assert list(registered(GROUP)) == ["square"]


def test_entry_points_are_read_once_until_the_path_changes(install, monkeypatch):
    read = []
    monkeypatch.setattr("piezo_common.registered.entry_points",
                        lambda group: read.append(group) or ())
    for _ in range(3):
        registered("piezo_test.read_once")
    assert read == ["piezo_test.read_once"]
    install("lab_shapes", "", square="lab_shapes:Square")
    registered("piezo_test.read_once")
    assert len(read) == 2
