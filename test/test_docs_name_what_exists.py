# SPDX-License-Identifier: BSD-3-Clause
"""Every path, module and function that README and docs name exists, and so does every target."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
               if path.name not in ("errors.md", "reproduction.md"))
FOLDERS = {path.name for path in ROOT.iterdir() if path.is_dir()} - {"runs", "build"}
PACKAGES = {path.parent.name for path in ROOT.glob("src/*/package.xml")}
GROUPS = {"piezo_models.effects", "piezo_sim.effects", "piezo_stage_driver.backends",
          "piezo_controller.references", "piezo_identification.experiments"}


def named(text):
    """Yield the inline code of a page, outside its blocks."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))


def missing(name):
    """Whether a name of inline code is a path or a module of ours that is not there."""
    if re.fullmatch(r"piezo_\w+(\.\w+)+", name):
        return name not in GROUPS and not is_module(name)
    first, slash, rest = name.partition("/")
    if not slash or not re.fullmatch(r"[\w./*-]+", name) or first not in FOLDERS | PACKAGES:
        return False
    places = [ROOT / name, ROOT / "src" / name, ROOT / "src" / first / first / rest,
              *(ROOT / "src" / first / kind / f"{rest}.{kind}"
                for kind in ("msg", "srv", "action"))]
    return not any(path.exists() for path in places)


def is_module(name):
    """Whether a dotted name is a module, or something in one."""
    path = ROOT / "src" / name.partition(".")[0] / name.replace(".", "/")
    if path.is_dir() or path.with_suffix(".py").is_file():
        return True
    module, _, attribute = name.rpartition(".")
    file = (ROOT / "src" / name.partition(".")[0] / module.replace(".", "/")).with_suffix(".py")
    return file.is_file() and attribute in file.read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_path_or_module_that_a_page_names_exists(page):
    assert [name for name in named(page.read_text(encoding="utf-8")) if missing(name)] == []


@pytest.mark.parametrize("name", [
    "piezo_models/no_such_room", "piezo_models.no_such_module", "test/no_such_test.py",
    "piezo_models.cascade.NoSuchModel", "piezo_interfaces/NoSuchMessage",
])
def test_name_of_what_is_not_there_is_found(name):
    assert missing(name)


def test_architecture_lists_every_package_and_help_every_target_that_a_page_names():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("## The packages")[2].partition("\n\n| folder")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.M)) == PACKAGES
    makefile = (ROOT / "Makefile").read_text()
    told = set(re.findall(r"^([a-z-]+):.*## ", makefile, re.M))
    assert set(re.findall(r"^([a-z-]+):", makefile, re.M)) == told
    pages = " ".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(re.findall(r"`make ([a-z-]+)", pages)) <= told


@pytest.mark.parametrize("index", sorted(ROOT.glob("docs/**/README.md")),
                         ids=lambda index: index.parent.name)
def test_index_of_a_folder_of_the_docs_lists_every_page(index):
    linked = set(re.findall(r"\]\(([\w./]+\.md)\)", index.read_text(encoding="utf-8")))
    pages = {path.name for path in index.parent.glob("*.md")} - {"README.md"}
    assert pages <= linked


def test_every_room_and_function_on_the_way_of_a_sample_exists():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    way = page.partition("## The way of one sample")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(piezo_[\w/]+)` \| `([\w.]+)` \|", way, re.M)
    assert len(rows) > 15
    for room, name in rows:
        package, _, inside = room.partition("/")
        folder = ROOT / "src" / package / package / inside
        sources = "".join(path.read_text() for path in sorted(folder.glob("*.py")))
        for part in name.split("."):
            assert re.search(rf"^\s*(async )?(def|class) {part}\b", sources, re.M), (
                f"{room} has no {part}")


def test_each_group_of_the_contributing_page_is_one_that_the_suite_looks_up():
    sources = "".join(path.read_text() for path in ROOT.glob("src/piezo_*/piezo_*/**/*.py"))
    table = (ROOT / "docs" / "CONTRIBUTING.md").read_text(encoding="utf-8")
    groups = {name for name in named(table) if re.fullmatch(r"piezo_\w+\.\w+", name)}
    assert groups == GROUPS
    assert all(f'GROUP = "{group}"' in sources for group in groups)


