# SPDX-License-Identifier: BSD-3-Clause
"""What a stranger meets first agrees with what is there: versions, requirements, targets."""

import re
import tomllib
from pathlib import Path

import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OF_CONDA = {"matplotlib": "matplotlib-base"}


def read(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_every_file_names_the_same_version_and_its_changes_are_told():
    version = PROJECT["version"]
    assert read("CITATION.cff")["version"] == read("conda/recipe.yaml")["context"]["version"]
    assert read("CITATION.cff")["version"] == version
    for manifest in ROOT.glob("src/*/package.xml"):
        assert f"<version>{version}</version>" in manifest.read_text(), manifest
    date = re.escape(str(read("CITATION.cff")["date-released"]))
    assert re.search(rf"^{re.escape(version)} \({date}\)\n-+$",
                     (ROOT / "CHANGELOG.rst").read_text(), re.M)


def test_conda_asks_for_what_pip_asks_for():
    pip = [Requirement(each) for each in PROJECT["dependencies"]]
    conda = [Requirement(each) for each in read("conda/recipe.yaml")["requirements"]["run"]]
    assert {each.name: each.specifier for each in conda} == {
        "python": Requirement(f"python {PROJECT['requires-python']}").specifier,
        **{OF_CONDA.get(each.name, each.name): each.specifier for each in pip}}


def test_workflow_tests_every_python_that_is_asked_for():
    jobs = read(".github/workflows/tests.yml")["jobs"]
    assert "make test" in str(jobs["suite"]["steps"])
    pythons = jobs["offline"]["strategy"]["matrix"]["python"]
    allowed = Requirement(f"python {PROJECT['requires-python']}").specifier
    assert [f"3.{minor}" for minor in range(30) if f"3.{minor}" in allowed] == pythons
    assert "build" in str(jobs["distribution"]["steps"])
    for template in ROOT.glob(".github/ISSUE_TEMPLATE/*.md"):
        _, head, body = template.read_text().split("---\n", 2)
        assert {"name", "about"} <= yaml.safe_load(head).keys() and body.strip()


def test_paper_cites_what_its_bibliography_holds():
    paper, bibliography = ((ROOT / "paper" / f"paper.{kind}").read_text() for kind in ("md", "bib"))
    _, head, text = paper.split("---\n", 2)
    assert yaml.safe_load(head)["bibliography"] == "paper.bib"
    cited = set(re.findall(r"@([\w-]+)", text))
    assert cited == set(re.findall(r"^@\w+\{([\w-]+),$", bibliography, re.M))
    assert len(text.split()) <= 1000  # which the journal asks for


def test_site_is_built_as_it_is_here_by_workflow_and_host():
    assert "make docs" in str(read(".github/workflows/tests.yml")["jobs"]["site"]["steps"])
    assert any("make docs" in each for each in read(".readthedocs.yaml")["build"]["commands"])


def test_gallery_shows_every_picture_that_its_tool_draws():
    drawn = re.findall(r'^    "(\w+)": \(|^    write\("(\w+)"',
                       (ROOT / "tools" / "gallery.py").read_text(), re.M)
    shown = re.findall(r"\(pictures/gallery/(\w+)\.png\)",
                       (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"))
    assert sorted(first or second for first, second in drawn) == sorted(shown)
    assert all((ROOT / "docs" / "pictures" / "gallery" / f"{name}.png").exists() for name in shown)
