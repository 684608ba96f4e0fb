# SPDX-License-Identifier: BSD-3-Clause
"""`./run` lists every executable with a sentence."""

import importlib.util
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("executables", ROOT / "tools" / "executables.py")
executables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(executables)


def test_each_executable_is_listed_with_a_sentence_of_its_own():
    listed = executables.listed()
    declared = {(path.parent.name, name) for path in ROOT.glob("src/*/setup.py")
                for name in re.findall(r'"(\w+) = [\w.]+:main"', path.read_text())}
    assert {(package, name) for package, names in listed.items() for name in names} == declared
    sentences = [text for names in listed.values() for text in names.values()]
    assert all(re.fullmatch(r"[A-Z].{10,}\.", text) for text in sentences), sentences
    assert len(set(sentences)) == len(sentences)


def test_run_lists_by_this_program():
    assert "tools/executables.py" in (ROOT / "run").read_text()
