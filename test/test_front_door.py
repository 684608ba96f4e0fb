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
