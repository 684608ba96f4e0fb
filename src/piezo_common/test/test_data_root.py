# SPDX-License-Identifier: BSD-3-Clause
"""Whatever path and name a node is given, what it writes lies under its data root."""

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from piezo_common.data_root import DataRoot, DataRootError, check_file_name

PARTS = ["", ".", "..", "inside", "new", "out", "up", "home", "loop", "file", "é", "a b",
         "x" * 255, "x" * 256, "new\nline", "nul\0", "\udc80", "\x1b[2J"]


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """Return a data root with symbolic links that lead out of it, back into it, and in a circle."""
    top = Path(os.path.realpath(tmp_path_factory.mktemp("tree")))
    root = top / "root"
    (root / "inside").mkdir(parents=True)
    (top / "elsewhere").mkdir()
    (root / "file").write_text("")
    for name, target in (("out", top / "elsewhere"), ("up", ".."), ("home", "inside"),
                         ("loop", "loop")):
        (root / name).symlink_to(target)
    return top


def clear(tree):
    """Remove what a path has led to, and return whether it was all under the root."""
    found = [Path(folder, name) for folder, _, names in os.walk(tree) for name in names
             if name == "written"]
    for path in found:
        path.unlink()
    for name in "new", "é", "a b", "x" * 255:
        for folder in (tree / "root", tree / "root" / "inside"):
            shutil.rmtree(folder / name, ignore_errors=True)
    return all(path.is_relative_to(tree / "root") for path in found)


@settings(deadline=None, max_examples=500)
@given(parts=st.lists(st.sampled_from(PARTS), max_size=6), absolute=st.sampled_from(["", "/", "@"]))
@example(parts=["out", "..", "root", "inside"], absolute="")
@example(parts=["..", "root", "new"], absolute="")
@example(parts=["inside", "..", "..", "root2"], absolute="")
@example(parts=["loop", "..", "out"], absolute="")
def test_what_is_accepted_lands_under_the_root(tree, parts, absolute):
    path = "/".join(parts)
    path = {"": "", "/": "/", "@": f"{tree / 'root'}/"}[absolute] + path
    try:
        directory = DataRoot(tree / "root", "recorder").writable(path)
    except DataRootError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 1000
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "written").write_text("")
    except OSError:  # a file or a circle is in the way
        pass
    assert clear(tree)


@given(parts=st.lists(st.sampled_from(["inside", "new", "é", "a b", "home"]), max_size=5))
def test_plain_paths_below_the_root_are_taken_as_they_are_meant(tree, parts):
    root = DataRoot(tree / "root", "recorder")
    wanted = tree.joinpath("root", *("inside" if part == "home" and n == 0 else part
                                     for n, part in enumerate(parts)))
    assert root.writable("/".join(parts)) == wanted
    assert root.writable(wanted) == wanted
    assert root.readable(str(wanted)) == str(wanted)


@pytest.mark.parametrize("path", ["..", "../elsewhere", "out", "out/new", "up", "up/elsewhere",
                                  "inside/../..", "/etc", "/", "//etc/x", "../root2",
                                  "out/../elsewhere"])
def test_a_path_that_leads_out_is_refused_with_the_root_and_the_cure(tree, path):
    with pytest.raises(DataRootError) as refused:
        DataRoot(tree / "root", "controller").writable(path)
    text = str(refused.value)
    assert f"'{path}' is outside {tree / 'root'}" in text
    assert "controller" in text
    assert "data_root" in text


def test_a_root_behind_a_link_is_the_folder_it_leads_to(tree):
    root = DataRoot(tree / "root" / "home", "recorder")
    assert root.folder == tree / "root" / "inside"
    assert root.writable(tree / "root" / "home" / "run") == tree / "root" / "inside" / "run"
    with pytest.raises(DataRootError, match="outside"):
        root.writable("../new")


@pytest.mark.parametrize("folder", ["/no/such/folder", "file"])
def test_a_root_must_be_a_folder(tree, folder):
    with pytest.raises(DataRootError, match="is no folder"):
        DataRoot(tree / "root" / folder, "recorder")


def test_files_to_read_lie_under_the_root_and_those_of_a_recording_too(tree, tmp_path):
    root = DataRoot(tree / "root", "controller")
    assert root.readable("") == ""
    assert root.readable("runs/model.json") == str(tree / "root" / "runs" / "model.json")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    (tmp_path / "bag" / "data.mcap").symlink_to("/dev/zero")
    for path in (tree / "root" / "out" / "model.json", "/dev/zero", "../elsewhere"):
        with pytest.raises(DataRootError, match="under which the node controller reads"):
            root.readable(str(path))
    with pytest.raises(DataRootError, match="data.mcap' is outside"):
        DataRoot(tmp_path, "controller").readable("bag")


@settings(deadline=None)
@given(name=st.text(max_size=120) | st.text("a./\\\n é日", max_size=90) | st.sampled_from(PARTS))
@example(name="日" * 85)
@example(name="a" * 100)
@example(name="con: run 1, 20 %")
def test_a_name_is_refused_or_names_one_entry_of_its_folder(tmp_path_factory, name):
    folder = tmp_path_factory.mktemp("names")
    try:
        check_file_name(name, "a recording")
    except DataRootError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 1000
        return
    (folder / name).mkdir()
    (folder / name / f"{name}_0.mcap").write_text("")
    assert os.listdir(folder) == [name]
    assert name in os.listdir(os.path.realpath(folder))
    assert not name.startswith(".")


@pytest.mark.parametrize("name", ["", ".", "..", ".hidden", "a/b", "../../x", "a\\b", "a\nb",
                                  "a\0b", "\x1b[2J", "\u2028", "\udc80", "a" * 101, "x" * 300,
                                  "日" * 81, " a", "a "])
def test_what_is_no_plain_name_is_refused(name):
    with pytest.raises(DataRootError, match="cannot name an attachment"):
        check_file_name(name, "an attachment")


@pytest.mark.parametrize("name", ["a", "run_2", "model.json", "é", "a b", "-x", "a..b", "日" * 80])
def test_plain_names_are_taken(name):
    check_file_name(name, "a recording")


def test_links_that_lead_to_each_other_behind_a_circle_are_refused(tmp_path):
    for name, target in (("loop", "loop"), ("one", "loop/../other"), ("other", "loop/../one")):
        (tmp_path / name).symlink_to(target)
    with pytest.raises(DataRootError, match="a circle of links: name a directory"):
        DataRoot(tmp_path, "recorder").writable("one")
